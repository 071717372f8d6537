"""Available memory, and early refusal of work that certainly needs more.

Nothing is refused where memory is unknown, such as on systems other than Linux, or where work might succeed:
needs are lower bounds, and available memory includes swap and caches that the system can drop.
"""

from collections.abc import Callable
from pathlib import PurePosixPath

from mjx_fit.utils.cgroups import ROOT, Read, groups_of, read_file
from mjx_fit.utils.errors import RequestError

try:
    import resource
except ImportError:  # not on Windows
    resource = None

_UNLIMITED = 2**60
"""Values above this mean no limit; control groups use various numbers for it."""

START_BYTES = 1_800_000_000
"""Smallest address space in which commands that compute can succeed.

With 1.74e9 bytes none did, on one CPU or two (MuJoCo 3.17, JAX 0.10); with 1.95e9 the smallest did."""

Limit = Callable[[str], int | None]
"""Function that returns a soft limit by its name in ``resource``, bytes; None: unlimited."""


def require(needed: int, what: str, remedy: str) -> None:
    """Check that there may be enough memory for some work.

    Args:
        needed: Lower bound of the peak memory, bytes.
        what: Start of the error message, such as ``--batch: 250``.
        remedy: Advice on what to change.

    Raises:
        RequestError: Less memory is available.
    """
    there = available()
    if there is not None and needed > there:
        raise RequestError(
            f"{what} cannot be used: it needs {_size(needed)} of memory or more, "
            f"and {_size(there)} are available: {remedy}"
        )


def require_start(limit: Limit | None = None) -> None:
    """Check that the address space suffices for the libraries, which would otherwise abort the process.

    Raises:
        RequestError: The limit ``ulimit -v`` is too small.
    """
    most = (limit or soft_limit)("RLIMIT_AS")
    if most is not None and most < START_BYTES:
        raise RequestError(
            f"ulimit -v: {most // 1024} ({_size(most)}) cannot be used: commands that compute need "
            f"{START_BYTES // 1024} ({_size(START_BYTES)}) or more"
        )


def available(read: Read | None = None, limit: Limit | None = None) -> int | None:
    """Return the memory that this process can still use: the smallest remainder of all its limits.

    Args:
        read: Function that reads a file; None: from the system.
        limit: Function that returns the process's limits; None: the actual ones.

    Returns:
        Memory available under process limits, control groups and machine, bytes; None if unknown.
    """
    read, limit = read or read_file, limit or soft_limit
    swap = _of_table(read(PurePosixPath("/proc/meminfo")), "SwapFree") or 0
    free = _of_table(read(PurePosixPath("/proc/meminfo")), "MemAvailable")
    left = [_under_limits(read, limit), None if free is None else free + swap]
    group = _in_groups(read)
    left.append(None if group is None else group + swap)
    return min((n for n in left if n is not None), default=None)


def soft_limit(name: str) -> int | None:
    if resource is None or not hasattr(resource, name):
        return None
    soft, _ = resource.getrlimit(getattr(resource, name))
    return None if soft == resource.RLIM_INFINITY or soft >= _UNLIMITED else soft


def _under_limits(read: Read, limit: Limit) -> int | None:
    status = read(PurePosixPath("/proc/self/status"))
    left = []
    for name, field in (("RLIMIT_AS", "VmSize"), ("RLIMIT_DATA", "VmData")):
        most, used = limit(name), _of_table(status, field)
        if most is not None and used is not None:
            left.append(max(0, most - used))
    return min(left, default=None)


def _in_groups(read: Read) -> int | None:
    """Return the smallest memory left in the control groups of this process, counting file caches as free."""
    left = []
    for line in (read(PurePosixPath("/proc/self/cgroup")) or "").splitlines():
        parts = line.split(":", 2)
        if len(parts) != 3:
            continue
        if not parts[1]:
            names, root = ("memory.max", "memory.current", "file"), ROOT
        elif "memory" in parts[1].split(","):
            names, root = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_cache"), ROOT / "memory"
        else:
            continue
        left += [_in_group(read, folder, *names) for folder in groups_of(root, parts[2])]
    return min((n for n in left if n is not None), default=None)


def _in_group(read: Read, folder: PurePosixPath, most: str, used: str, cache: str) -> int | None:
    limit, usage = (_number(read(folder / name)) for name in (most, used))
    if limit is None or usage is None or limit >= _UNLIMITED:
        return None
    dropped = 0
    for line in (read(folder / "memory.stat") or "").splitlines():
        name, _, value = line.partition(" ")
        if name == cache:
            dropped = _number(value) or 0
    return max(0, limit - max(0, usage - dropped))


def _of_table(text: str | None, field: str) -> int | None:
    """Parse a field of a /proc table, "MemAvailable:   12 kB", in bytes."""
    for line in (text or "").splitlines():
        name, _, value = line.partition(":")
        if name == field:
            words = value.split()
            number = _number(words[0]) if words else None
            return None if number is None else 1024 * number
    return None


def _number(text: str | None) -> int | None:
    word = (text or "").strip()
    return int(word) if word.isascii() and word.isdecimal() and len(word) < 20 else None


def _size(n: int) -> str:
    return f"{n / 1e9:,.1f} GB" if n >= 1e9 else f"{n / 1e6:,.0f} MB"
