"""Persistent cache of compiled computations; damaged entries are compiled again."""

import contextlib
import os
import re
import sys
import warnings
from pathlib import Path

import platformdirs

CACHE = Path(platformdirs.user_cache_dir("mjx_fit"))
"""Folder of cached, reproducible files."""

_DAMAGED = re.compile(r"Error reading persistent compilation cache entry for '([^']+)'")


def folder(asked: str | None) -> Path | None:
    """Create and return the cache folder; if that fails, print a line to stderr and return None.

    Args:
        asked: User's choice, ``JAX_COMPILATION_CACHE_DIR``; None: the default folder.
    """
    if asked is not None and "://" in asked:  # JAX also supports cloud buckets
        return Path(asked)
    path = CACHE / "xla" if asked is None else Path(asked)
    try:
        if not path.is_absolute() and asked is None:
            raise OSError("this user has no home folder")
        if asked is None and path.is_file():
            path.unlink()
        path.mkdir(parents=True, exist_ok=True)
        if not os.access(path, os.W_OK | os.X_OK):
            raise OSError(f"{path} cannot be written")
    except OSError as error:
        name = "" if asked is None else f"JAX_COMPILATION_CACHE_DIR={asked}: "
        why = f"{path}: {error.strerror}" if error.strerror else str(error)
        print(f"mjx-fit: {name}compiled computations are not cached: {why}", file=sys.stderr)
        return None
    return path


def replace_damaged(path: Path) -> None:
    """Delete damaged entries of a folder when JAX warns about them, just before it compiles again.

    JAX never overwrites an entry: without this, every later process would warn and compile again.
    """
    show = warnings.showwarning

    def showwarning(message, category, *rest, **more) -> None:
        found = _DAMAGED.search(str(message))
        if found is None:
            show(message, category, *rest, **more)
        else:
            _delete(path, found[1])

    warnings.filterwarnings("always", message=_DAMAGED.pattern)
    warnings.showwarning = showwarning


def _delete(path: Path, name: str) -> None:
    """Delete all entries of the computation with this name; JAX does not name the damaged one."""
    print(f"mjx-fit: a cached computation ({name}) in {path} is damaged: compiling it again", file=sys.stderr)
    for entry in path.iterdir():
        if entry.name.startswith(f"{name}-") and entry.name.endswith("-cache"):
            with contextlib.suppress(OSError):
                entry.rmdir() if entry.is_dir() else entry.unlink()
