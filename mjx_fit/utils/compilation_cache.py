"""Compiled computations that are kept from one command to the next: what is damaged is made again."""

import contextlib
import os
import re
import sys
import warnings
from pathlib import Path

import platformdirs

CACHE = Path(platformdirs.user_cache_dir("mjx_fit"))
"""Where what can be made again is kept."""

_DAMAGED = re.compile(r"Error reading persistent compilation cache entry for '([^']+)'")


def folder(asked: str | None) -> Path | None:
    """The folder to keep them in, made; None, and a line on stderr, where none can be.

    Args:
        asked: The user's own choice, ``JAX_COMPILATION_CACHE_DIR``.
    """
    if asked is not None and "://" in asked:  # JAX can keep them in a bucket, too
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
        print(f"mjx-fit: {name}compiled computations are not kept: {why}", file=sys.stderr)
        return None
    return path


def replace_damaged(path: Path) -> None:
    """Lets damaged entries of a folder be deleted when JAX warns of them, just before it compiles again.

    JAX never overwrites an entry: without this it would warn, and compile, in every process to come.
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
    """Deletes what is kept of the computation with this name; JAX does not say which entry is damaged."""
    print(f"mjx-fit: a kept computation ({name}) in {path} is damaged: compiling it again", file=sys.stderr)
    for entry in path.iterdir():
        if entry.name.startswith(f"{name}-") and entry.name.endswith("-cache"):
            with contextlib.suppress(OSError):
                entry.rmdir() if entry.is_dir() else entry.unlink()
