"""Linux control groups: location and reading of a process's resource limits."""

from collections.abc import Callable
from pathlib import Path, PurePosixPath

ROOT = PurePosixPath("/sys/fs/cgroup")

Read = Callable[[PurePosixPath], str | None]
"""Function that returns the text of a file, or None if it cannot be read."""


def read_file(path: PurePosixPath) -> str | None:
    """Read a text file; None if it cannot be read."""
    try:
        return Path(path).read_text(encoding="utf-8")
    except (OSError, ValueError):
        return None


def groups_of(root: PurePosixPath, group: str) -> list[PurePosixPath]:
    """List the folders of a control group and its ancestors; in a container only the root exists."""
    names = [name for name in group.split("/") if name not in ("", ".", "..")]
    return [root.joinpath(*names[:depth]) for depth in range(len(names), -1, -1)]
