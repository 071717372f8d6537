"""The examples that read a data set without this library."""

import subprocess
import sys
from pathlib import Path

import pytest
from collecting import Collector, run

EXAMPLES = Path(__file__).parent.parent / "experiments" / "data"


@pytest.fixture(scope="module")
def folder(native, tmp_path_factory):
    return Collector(native)(tmp_path_factory.mktemp("data") / "set", sequence=2)


def test_plain_h5py(folder):
    done = run([sys.executable, str(EXAMPLES / "read_h5py.py"), str(folder)])
    assert done.returncode == 0, done.stderr
    assert "10 interactions, policy mixed" in done.stdout
    assert "trace/wrench_sensor" in done.stdout
    assert "[N, N·m] sensor force and torque" in done.stdout
    assert "episode 0: cross in cross, 3 actions" in done.stdout


def test_plain_h5py_on_the_sample():
    done = run([sys.executable, str(EXAMPLES / "read_h5py.py"), str(EXAMPLES / "sample")])
    assert done.returncode == 0, done.stderr
    assert "24 interactions, policy mixed" in done.stdout


def test_plain_h5py_needs_nothing_of_this_library():
    for name in ("read_h5py.py", "read_torch.py"):
        assert "mjx_fit" not in (EXAMPLES / name).read_text()


def test_torch(folder):
    pytest.importorskip("torch")
    done = run([sys.executable, str(EXAMPLES / "read_torch.py"), str(folder)])
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0] == "10 interactions"
    assert "wrench (10, 3, 50, 6), lengths 3 to 3" in done.stdout
    assert "6 matched" in done.stdout


def test_the_array_job_is_a_shell_script_that_parses():
    subprocess.run(["bash", "-n", str(EXAMPLES / "slurm.sh")], check=True)


OWN = EXAMPLES.parent / "own"


def own(name: str, *words: object) -> list[str]:
    done = run([sys.executable, str(OWN / name), *map(str, words)])
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_a_shape_of_ones_own(tmp_path):
    told = own("shape.py", tmp_path / "set", 12, 3)
    assert "ell-ell: 0 of 2 inserted" in told
    assert {line.split(":")[0] for line in told} > {"ell-rectangle", "square-square"}


def test_a_policy_of_ones_own():
    told = own("policy.py", 2)
    assert [line.split(":")[0] for line in told] == ["spiral", "raster"]
    assert all(line.endswith("of 2 inserted") for line in told)


def test_a_sensor_of_ones_own(native, tmp_path):
    folders = [Collector(native)(tmp_path / f"set{seed}", seed=seed) for seed in (1, 2)]
    told = own("sensor.py", *folders)
    assert [line.split(":")[0] for line in told] == ["nothing", "linear sensor"]


def test_a_filter_of_ones_own():
    told = own("filter.py", 2)
    assert [line.split(":")[0] for line in told] == ["Kalman", "particles"]
    assert all(1 <= float(line.split()[1]) <= 10 for line in told)


def test_examples_stay_short():
    for path in OWN.glob("*.py"):
        assert len(path.read_text().splitlines()) < 60, path
