"""How much memory can be had, and refusing what certainly needs more before the work begins."""

import resource
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjx_fit.cli import main
from mjx_fit.config.schema import Config
from mjx_fit.data.schedule import draw_attempts
from mjx_fit.utils import memory
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.rates import ACTION_BYTES

CONFIG = Config()
GB, MB = 10**9, 10**6
MEMINFO = "MemTotal: 16000000 kB\nMemAvailable: 8000000 kB\nSwapFree: 1000000 kB\n"
STATUS = "VmSize:\t  2000000 kB\nVmData:\t  500000 kB\n"
G = "/sys/fs/cgroup"


def reader(files):
    return lambda path: files.get(str(path))


def no_limit(name):
    return None


@pytest.mark.parametrize(
    ("files", "limits", "expected"),
    [
        ({}, {}, None),
        ({"/proc/meminfo": MEMINFO}, {}, 9_000_000 * 1024),
        ({"/proc/self/status": STATUS}, {"RLIMIT_AS": 3_000_000 * 1024}, 1_000_000 * 1024),
        ({"/proc/self/status": STATUS}, {"RLIMIT_AS": 1_000_000 * 1024}, 0),
        ({"/proc/self/status": STATUS}, {"RLIMIT_DATA": 700_000 * 1024}, 200_000 * 1024),
        ({"/proc/meminfo": MEMINFO, "/proc/self/status": STATUS}, {"RLIMIT_AS": GB * 100}, 9_000_000 * 1024),
        (
            {
                "/proc/self/cgroup": "0::/a/b\n",
                f"{G}/a/memory.max": "1000\n",
                f"{G}/a/memory.current": "400\n",
            },
            {},
            600,
        ),
        # Caches of files are dropped before anything is refused.
        (
            {
                "/proc/self/cgroup": "0::/\n",
                f"{G}/memory.max": "1000",
                f"{G}/memory.current": "900",
                f"{G}/memory.stat": "anon 100\nfile 800\n",
            },
            {},
            900,
        ),
        (
            {
                "/proc/self/cgroup": "4:memory:/job\n",
                f"{G}/memory/job/memory.limit_in_bytes": "9223372036854771712",
                f"{G}/memory/job/memory.usage_in_bytes": "5",
                f"{G}/memory/memory.limit_in_bytes": "1000",
                f"{G}/memory/memory.usage_in_bytes": "5",
            },
            {},
            995,
        ),
        ({"/proc/self/cgroup": "0::/\n", f"{G}/memory.max": "max", f"{G}/memory.current": "5"}, {}, None),
        ({"/proc/meminfo": "MemAvailable: lots\nMemAvailable\n", "/proc/self/cgroup": ":::"}, {}, None),
    ],
)
def test_what_can_be_had_is_the_least_that_anything_leaves(files, limits, expected):
    assert memory.available(reader(files), limits.get) == expected


@given(st.text(max_size=50), st.text(max_size=50), st.text(max_size=20))
def test_nonsense_in_the_systems_files_refuses_nothing(table, groups, number):
    files = {
        "/proc/meminfo": table,
        "/proc/self/status": "VmSize: " + number,
        "/proc/self/cgroup": groups + "\n0::/" + groups,
        f"{G}/memory.max": number,
        f"{G}/memory.current": number,
        f"{G}/memory.stat": table,
    }
    found = memory.available(reader(files), no_limit)
    assert found is None or found >= 0


def test_the_machine_says_something_here():
    found = memory.available()
    assert found is None or found > 100 * MB


def having(monkeypatch, there):
    monkeypatch.setattr(memory, "available", lambda: there)


def test_a_collection_that_cannot_fit_is_refused_before_anything_is_made(monkeypatch, tmp_path, capsys):
    having(monkeypatch, 4 * GB)
    out = tmp_path / "data"
    huge = ["collect", "--episodes", "65536", "--batch", "65536", "--steps", "1000", "--out", str(out)]
    assert main.main(huge) == 2
    assert capsys.readouterr().err == (
        "mjx-fit: --batch: 65536 with up to 1000 actions cannot be used: it needs 91.1 GB of memory or more, "
        "and 4.0 GB are available: lower it\n"
    )
    assert not out.exists()


def test_attempts_that_cannot_fit_are_refused_by_an_engine(monkeypatch, native):
    """So no evaluation begins them either."""
    having(monkeypatch, 100 * MB)
    many = draw_attempts(jax.random.key(0), jnp.arange(1000), "spiral", CONFIG)
    with pytest.raises(
        RequestError, match=r"attempts: 1,000 of 100 actions .* needs 126 MB .* run fewer at once"
    ):
        native.run(many, 100)
    having(monkeypatch, 1000 * 100 * ACTION_BYTES)
    native.run(many, 100, np.zeros(1000, bool))


def test_training_that_cannot_fit_is_refused_before_the_data_are_read(monkeypatch, tmp_path, collect, capsys):
    collect(tmp_path / "data", episodes=20, actions=12, policy="random", batch=20)
    having(monkeypatch, 20 * 12 * ACTION_BYTES - 1)
    asked = ["train", "--data", str(tmp_path / "data"), "--out", str(tmp_path / "run")]
    assert main.main(asked) == 2
    assert "--data: 20 interactions cannot be used: it needs 0 MB" in capsys.readouterr().err
    having(monkeypatch, 20 * 12 * ACTION_BYTES)
    assert main.main(asked) == 2
    assert "config: train.batch_size: 32 with these data cannot be used" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_what_an_action_takes_is_what_is_allocated(native):
    attempts = draw_attempts(jax.random.key(0), jnp.arange(2), "spiral", CONFIG)
    trace = native.run(attempts, 3, np.zeros(2, bool)).felt.trace
    assert sum(leaf.nbytes for leaf in jax.tree.leaves(trace)) == 2 * 3 * ACTION_BYTES


def test_a_limit_under_which_nothing_can_start_is_refused(monkeypatch, tmp_path, capsys):
    """Before the libraries are imported, which would abort the process."""
    for most in (0, 10**6, memory.START_BYTES - 1):
        with pytest.raises(RequestError, match=r"ulimit -v: .* need 1757812 \(1.8 GB\) or more"):
            memory.require_start({"RLIMIT_AS": most}.get)
    for limits in ({"RLIMIT_AS": memory.START_BYTES}, {}):
        memory.require_start(limits.get)
    monkeypatch.setattr(memory, "soft_limit", {"RLIMIT_AS": 500 * MB}.get)
    assert main.main(["collect", "--out", str(tmp_path / "data")]) == 2
    assert capsys.readouterr().err.startswith("mjx-fit: ulimit -v: 488281 (500 MB) cannot be used: ")
    assert not (tmp_path / "data").exists()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="only Linux limits the address space so")
@pytest.mark.parametrize("above_mb", [20, 300, 600, 900, 1200, 1600])
def test_under_a_limit_a_command_says_why_it_ends(above_mb, tmp_path):
    """Never by a signal or a traceback: it is refused, or says that memory is short, or gets through."""
    start = 60  # MB that the interpreter itself takes
    asked = ["collect", "--episodes", "6", "--policy", "spiral", "--actions", "20", "--out"]
    limit = (start + above_mb) * MB

    def bound():
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))

    argv = [sys.executable, "-m", "mjx_fit", *asked, str(tmp_path / "data")]
    done = subprocess.run(argv, preexec_fn=bound, capture_output=True, text=True, check=False)
    assert done.returncode in (0, 1, 2), done.stderr
    assert "Traceback" not in done.stderr
    if done.returncode:
        assert done.stderr.splitlines()[-1].startswith("mjx-fit: ")


def test_a_request_is_read_before_large_imports():
    """Under a small ``ulimit -v`` NumPy cannot be loaded, and the line that says so must come first."""
    code = (
        "import sys, mjx_fit.cli.main as m; m.parser(); print(*{'numpy', 'jax', 'mujoco'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""
