"""Pools: the parts of a job are done here or by workers of a Ray cluster, whatever happens to the workers."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mjx_fit.jobs.pool import Here
from mjx_fit.utils import provenance
from mjx_fit.utils.errors import RequestError, WorkError

ray = pytest.importorskip("ray")

from mjx_fit.jobs import ray_pool  # noqa: E402
from mjx_fit.jobs.ray_pool import RayPool, connect  # noqa: E402
from mjx_fit.jobs.worker import Report  # noqa: E402

PIECES = {f"part {n}": n for n in range(5)}


def squared(piece, tell):
    tell(piece, "squaring")
    return piece**2


class Served:
    """A cluster in another process (``local_cluster``)."""

    def __init__(self):
        script = Path(__file__).with_name("local_cluster.py")
        self.process = subprocess.Popen(
            [sys.executable, str(script)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.address = self._line()

    def _line(self):
        assert self.process.stdout
        return self.process.stdout.readline().strip()

    def change(self, what):
        """Add a node, or remove it again."""
        assert self.process.stdin
        self.process.stdin.write(f"{what}\n")
        self.process.stdin.flush()
        assert self._line() == "done"


@pytest.fixture(scope="module")
def cluster():
    made = Served()
    if not made.address:  # a sandbox may forbid its processes
        pytest.skip("Ray does not start here")
    yield made
    ray.shutdown()
    made.process.communicate()


@pytest.fixture(scope="module")
def pool(cluster):
    return RayPool(cluster.address)


def by_value(function):
    """Return a function that workers need not import: they have no test modules."""
    from ray import cloudpickle

    cloudpickle.register_pickle_by_value(__import__(function.__module__))
    return function


def run(pool, work, pieces=PIECES, **more):
    return dict(pool.run(by_value(work), pieces, lambda *_: None, **more))


def test_here_is_one_after_the_other_with_progress_within():
    told = []
    done = list(Here().run(squared, PIECES, lambda *words: told.append(words)))
    assert done == [(name, n**2) for name, n in PIECES.items()]
    assert told == [(n, "squaring") for n in range(5)]


def test_workers_give_the_same(pool):
    assert run(pool, squared) == dict(Here().run(squared, PIECES, lambda *_: None))


@pytest.mark.parametrize("shared", [False, True])
def test_results_are_stored_by_the_workers_or_beside_the_driver(shared, cluster, tmp_path):
    def store(value):
        (tmp_path / f"{value}.txt").write_text(str(os.getppid()))
        return -value

    pool = RayPool(cluster.address, shared=shared)
    assert run(pool, squared, store=store) == {name: -(n**2) for name, n in PIECES.items()}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0.txt", "1.txt", "16.txt", "4.txt", "9.txt"]


def test_a_worker_that_dies_costs_its_part_alone(pool, tmp_path, capsys):
    def work(piece, tell):
        with (tmp_path / f"{piece}").open("a") as file:
            file.write("x")
        if piece == 2 and (tmp_path / "2").read_text() == "x":
            os._exit(1)
        return piece

    assert run(pool, work) == PIECES
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        str(n): "xx" if n == 2 else "x" for n in range(5)
    }
    assert "part 2 is done again: its worker was lost (WorkerCrashedError)" in capsys.readouterr().err


def test_a_part_that_fails_three_times_ends_the_command_with_its_reason(pool, tmp_path):
    def work(piece, tell):
        if piece == 1:
            (tmp_path / str(time.monotonic_ns())).touch()
            raise ValueError("singular matrix")
        return piece

    with pytest.raises(WorkError, match=r"part 1 failed 3 times; .*ValueError: singular matrix \(test_pools"):
        run(pool, work)
    assert len(list(tmp_path.iterdir())) == 3


def test_what_a_part_refuses_is_refused(pool):
    def work(piece, tell):
        raise RequestError("--trials: 0 is out of range")

    with pytest.raises(RequestError, match="--trials: 0 is out of range"):
        run(pool, work)


def test_a_full_disk_is_one_line(pool):
    def store(value):
        raise OSError(28, "No space left on device", "/data/shard-0.h5")

    with pytest.raises(WorkError, match=r"part \d cannot be stored: .*No space left on device"):
        run(pool, squared, store=store)


def test_workers_of_another_version_are_named(pool, monkeypatch):
    there = provenance.versions() | {"numpy": "9.9"}
    monkeypatch.setattr(provenance, "versions", lambda: there)
    with pytest.raises(WorkError, match=r"the worker on .* cannot be used: it has numpy .*driver has 9\.9"):
        run(pool, squared)


def test_a_worker_without_the_package_says_so(monkeypatch):
    """What travels by value is called as on a machine where nothing is installed."""
    monkeypatch.setitem(sys.modules, "mjx_fit.jobs.worker", None)
    monkeypatch.delattr("mjx_fit.jobs.worker", raising=False)
    told, result = ray_pool._perform()(b"", 0, ("", {}, 1))
    report = Report(*told)
    assert result is None
    assert report.unfit is not None
    assert report.unfit.endswith("install mjx-fit there")


def test_a_slow_worker_holds_nobody_up(pool, cluster, tmp_path, capsys, monkeypatch):
    """The first one to take the last piece sleeps; another worker does it, too."""
    monkeypatch.setattr("mjx_fit.jobs.ray_pool.SLOW_FROM_S", 1.0)
    cluster.change("add")

    def work(piece, tell):
        try:
            (tmp_path / "asleep").open("x")
        except FileExistsError:
            return piece
        time.sleep(600)
        return piece

    began = time.monotonic()
    assert run(pool, work) == PIECES
    assert time.monotonic() - began < 120
    assert "it is started on another worker, too" in capsys.readouterr().err
    cluster.change("remove")


def test_an_address_where_nobody_answers_is_refused(pool):
    ray.shutdown()
    with pytest.raises(RequestError, match="--cluster: nonsense cannot be used: no cluster answers there"):
        connect("nonsense")
