"""How many CPUs a process was granted, from files and variables as containers and clusters have them."""

from pathlib import PurePosixPath

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjx_fit.cli import main
from mjx_fit.utils import granted_cpus
from mjx_fit.utils.cgroups import read_file

V2 = "/sys/fs/cgroup"


def reading(files):
    return lambda path: files.get(str(path))


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({}, 8),
        ({"/proc/self/cgroup": "0::/\n", f"{V2}/cpu.max": "200000 100000\n"}, 2),
        ({"/proc/self/cgroup": "0::/\n", f"{V2}/cpu.max": "max 100000\n"}, 8),
        ({"/proc/self/cgroup": "0::/\n", f"{V2}/cpu.max": "150000 100000\n"}, 2),  # 1.5 CPUs: two threads
        ({"/proc/self/cgroup": "0::/\n", f"{V2}/cpu.max": "10000 100000\n"}, 1),
        # Nested: the group itself says nothing, one above it does; the least counts.
        (
            {
                "/proc/self/cgroup": "0::/slurm/job_7/step_0\n",
                f"{V2}/slurm/job_7/step_0/cpu.max": "max 100000\n",
                f"{V2}/slurm/job_7/cpu.max": "300000 100000\n",
                f"{V2}/cpu.max": "600000 100000\n",
            },
            3,
        ),
        # Inside a container the group that is named is not there: its root is what is seen.
        ({"/proc/self/cgroup": "0::/docker/abc\n", f"{V2}/cpu.max": "400000 100000\n"}, 4),
        ({"/proc/self/cgroup": "0::/../../elsewhere\n", f"{V2}/cpu.max": "400000 100000\n"}, 4),
        (
            {
                "/proc/self/cgroup": "5:memory:/x\n4:cpu,cpuacct:/job\n0::/\n",
                f"{V2}/cpu,cpuacct/job/cpu.cfs_quota_us": "500000\n",
                f"{V2}/cpu,cpuacct/job/cpu.cfs_period_us": "100000\n",
            },
            5,
        ),
        (
            {
                "/proc/self/cgroup": "1:cpu:/\n",
                f"{V2}/cpu/cpu.cfs_quota_us": "-1\n",
                f"{V2}/cpu/cpu.cfs_period_us": "100000\n",
            },
            8,
        ),
        ({"/proc/self/cgroup": "1:cpu:/\n", f"{V2}/cpu/cpu.cfs_quota_us": "100000\n"}, 8),
        ({"/proc/self/cgroup": "0::/\n", f"{V2}/cpu.max": "100000 0\n"}, 8),
        ({"/proc/self/cgroup": "nonsense\n::::\n\x00", f"{V2}/cpu.max": "\x00"}, 8),
    ],
)
def test_quotas_of_control_groups(files, expected):
    assert granted_cpus.cpus(8, {}, reading(files)) == expected


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({"SLURM_CPUS_PER_TASK": "1"}, 1),
        ({"OMP_NUM_THREADS": "3"}, 3),
        ({"OMP_NUM_THREADS": "4,2"}, 4),
        ({"OMP_NUM_THREADS": "6", "SLURM_CPUS_PER_TASK": "2"}, 2),
        ({"OMP_NUM_THREADS": "64"}, 8),
        ({"OMP_NUM_THREADS": "0"}, 8),
        ({"OMP_NUM_THREADS": "-2"}, 8),
        ({"OMP_NUM_THREADS": "two"}, 8),
        ({"OMP_NUM_THREADS": ""}, 8),
        ({"OMP_NUM_THREADS": "1e3"}, 8),
        ({"OMP_NUM_THREADS": "²"}, 8),
        ({"SLURM_CPUS_PER_TASK": "9" * 5000}, 8),
    ],
)
def test_variables_count_where_they_make_sense(variables, expected):
    assert granted_cpus.cpus(8, variables, lambda path: None) == expected


@given(
    st.integers(1, 512),
    st.dictionaries(st.sampled_from(["SLURM_CPUS_PER_TASK", "OMP_NUM_THREADS"]), st.text(max_size=20)),
    st.text(max_size=60),
    st.text(max_size=20),
)
def test_nonsense_is_no_crash_and_at_least_one_thread_is_left(affinity, variables, groups, quota):
    read = reading({"/proc/self/cgroup": groups, f"{V2}/cpu.max": quota, f"{V2}/cpu/cpu.cfs_quota_us": quota})
    assert 1 <= granted_cpus.cpus(affinity, variables, read) <= affinity
    with_group = reading({"/proc/self/cgroup": f"0::/{groups}", f"{V2}/cpu.max": quota})
    assert 1 <= granted_cpus.cpus(affinity, variables, with_group) <= affinity


def test_engines_use_what_was_granted(monkeypatch):
    monkeypatch.setenv("SLURM_CPUS_PER_TASK", "1")
    assert granted_cpus.cpus() == 1


def test_threads_is_a_limit_for_what_is_not_started_yet(monkeypatch):
    for name in ("SLURM_CPUS_PER_TASK", "OMP_NUM_THREADS", "PJRT_NPROC"):
        monkeypatch.setenv(name, "")  # so that it is put back
        monkeypatch.delenv(name)
    monkeypatch.setattr(granted_cpus, "_affinity", lambda: 8)
    monkeypatch.setattr(granted_cpus, "_quota", lambda read: None)
    granted_cpus.limit_to(None)
    assert "PJRT_NPROC" not in granted_cpus.os.environ  # a plain shell stays as it is
    granted_cpus.limit_to(3)
    assert granted_cpus.cpus() == 3
    assert granted_cpus.os.environ["PJRT_NPROC"] == "3"
    monkeypatch.setenv("SLURM_CPUS_PER_TASK", "2")
    assert granted_cpus.cpus() == 2


@pytest.mark.parametrize("n", ["0", "-4", "1000000000", "1.5", "many"])
def test_threads_has_a_range(n, capsys, tmp_path):
    assert main.main(["collect", "--threads", n, "--out", str(tmp_path / "data")]) == 2
    assert "--threads" in capsys.readouterr().err
    assert not (tmp_path / "data").exists()


def test_a_file_that_cannot_be_read_says_nothing(tmp_path):
    assert read_file(PurePosixPath(tmp_path)) is None
    (tmp_path / "x").write_bytes(b"\xff\xfe")
    assert read_file(PurePosixPath(tmp_path / "x")) is None
