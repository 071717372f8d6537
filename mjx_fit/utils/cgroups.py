"""Linux control groups: where a process finds what it was granted, and reading it."""

from collections.abc import Callable
from pathlib import Path, PurePosixPath

ROOT = PurePosixPath("/sys/fs/cgroup")

Read = Callable[[PurePosixPath], str | None]
"""Text of a file; None where there is none that can be read."""


def read_file(path: PurePosixPath) -> str | None:
    """The text of a file; None where there is none that can be read."""
    try:
        return Path(path).read_text(encoding="utf-8")
    except (OSError, ValueError):
        return None


def groups_of(root: PurePosixPath, group: str) -> list[PurePosixPath]:
    """The folder of a control group, and of all that hold it; within a container the root alone is there."""
    names = [name for name in group.split("/") if name not in ("", ".", "..")]
    return [root.joinpath(*names[:depth]) for depth in range(len(names), -1, -1)]
