"""Number of CPUs granted to this process by the scheduler, a container, a cluster or OpenMP.

A job may use only some CPUs of a machine. More threads than CPUs are slower, and take CPUs from other users.
"""

import math
import os
from collections.abc import Mapping
from pathlib import PurePosixPath

from mjx_fit.utils.cgroups import ROOT, Read, groups_of, read_file
from mjx_fit.utils.errors import RequestError

MOST_THREADS = 4096

_SLURM, _OPENMP, _XLA = "SLURM_CPUS_PER_TASK", "OMP_NUM_THREADS", "PJRT_NPROC"


def limit_to(n: int | None) -> None:
    """Limit this process and its children to as many threads as it was granted.

    XLA on a CPU creates a pool with as many threads as the scheduler allows, regardless of other limits. Call
    this before JAX computes anything. Compilation still uses all of them.

    Args:
        n: Maximum number of threads (``--threads``), replacing OpenMP's variable; None: as many as granted.

    Raises:
        RequestError: The number is out of range.
    """
    if n is not None:
        if not 1 <= n <= MOST_THREADS:
            raise RequestError(f"--threads: {n} is out of range: expected 1 to {MOST_THREADS}")
        os.environ[_OPENMP] = str(n)
    granted = cpus()
    if granted < _affinity():
        os.environ.setdefault(_XLA, str(granted))


def cpus(
    affinity: int | None = None, environment: Mapping[str, str] | None = None, read: Read | None = None
) -> int:
    """Return the number of CPUs granted to this process: the smallest limit, at least 1.

    Invalid limits are ignored.

    Args:
        affinity: Number of CPUs allowed by the scheduler; None: the current value.
        environment: Environment variables; None: those of the process.
        read: Function that reads a file; None: from the system.
    """
    affinity = _affinity() if affinity is None else affinity
    environment = os.environ if environment is None else environment
    said = [
        affinity,
        *(_count(environment.get(name, "")) for name in (_SLURM, _OPENMP)),
        _quota(read or read_file),
    ]
    return max(1, min(n for n in said if n is not None))


def _affinity() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _count(text: str) -> int | None:
    """Parse a positive integer; OpenMP allows one per nesting level, and the first one is used."""
    first = text.split(",", maxsplit=1)[0].strip()
    return int(first) if first.isascii() and first.isdecimal() and len(first) < 10 and int(first) else None


def _quota(read: Read) -> int | None:
    """Return the smallest CPU quota among the control groups of this process, rounded up."""
    shares = []
    for line in (read(PurePosixPath("/proc/self/cgroup")) or "").splitlines():
        parts = line.split(":", 2)
        if len(parts) != 3:
            continue
        _, controllers, group = parts
        if controllers == "":
            shares += [_share_v2(read(folder / "cpu.max")) for folder in groups_of(ROOT, group)]
        elif "cpu" in controllers.split(","):
            for root in (ROOT / controllers, ROOT / "cpu"):
                shares += [_share_v1(read, folder) for folder in groups_of(root, group)]
    least = min((share for share in shares if share is not None), default=None)
    return None if least is None else max(1, math.ceil(least))


def _share_v2(text: str | None) -> float | None:
    words = (text or "").split()
    return _share(*words) if len(words) == 2 else None


def _share_v1(read: Read, folder: PurePosixPath) -> float | None:
    quota, period = (read(folder / f"cpu.cfs_{name}_us") for name in ("quota", "period"))
    return None if quota is None or period is None else _share(quota.strip(), period.strip())


def _share(quota: str, period: str) -> float | None:
    sound = all(
        word.isascii() and word.isdecimal() and len(word) < 16 and int(word) for word in (quota, period)
    )
    return int(quota) / int(period) if sound else None  # "max" and -1 mean no limit
