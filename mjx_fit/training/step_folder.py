"""Folders of numbered steps, written atomically, with the SHA-256 of every file."""

import errno
import json
import os
import re
import secrets
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

from pydantic import Field, TypeAdapter

from mjx_fit.utils import bounded_json, files

DIGESTS = "digests.json"
EARLIER = "_CHECKPOINT_METADATA"
"""File that marks a step from an earlier version without digests."""

_STEP = re.compile(r"0|[1-9][0-9]{0,8}")
_TEMPORARY = re.compile(r"[0-9]+\.[0-9a-f]{16}\.tmp|.*orbax-checkpoint-tmp.*|\..*")
"""Names of temporary files after a kill, from this and earlier versions, and of hidden desktop files."""
_STALE = re.compile(r"[0-9]+\.[0-9a-f]{16}\.tmp|[0-9]+\.orbax-checkpoint-tmp.*")
_MOST_FILES = 10_000
_UNSUPPORTED = {errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP}

_SCHEMA = TypeAdapter(dict[str, Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]])


def write(folder: Path, step: int, fill: Callable[[Path], None]) -> None:
    """Write a step, then remove the previous ones; a kill at any moment leaves one of them intact.

    Args:
        folder: Folder of the steps.
        step: Number of the step.
        fill: Function that writes the files into an empty folder.
    """
    files.make_folder(folder)
    _remove(path for path in folder.iterdir() if _STALE.fullmatch(path.name))
    temporary, target = _temporary(folder, step), folder / str(step)
    temporary.mkdir()
    try:
        fill(temporary)
        digests = {name: files.sha256(temporary / name) for name in sorted(_files(temporary))}
        (temporary / DIGESTS).write_text(_rendered(digests))
        _sync_all(temporary)
        if os.path.lexists(target):  # the epoch was repeated: same result, or from another machine
            target.rename(_temporary(folder, step))
        temporary.rename(target)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise
    _sync(folder)
    _remove(path for path in folder.iterdir() if path != target and _is_ours(path.name))


def newest(folder: Path) -> Path | None:
    """Return the folder of the last step, or None if no step exists.

    Raises:
        ValueError: The folder holds something other than steps.
    """
    steps: list[Path] = []
    for path in folder.iterdir() if folder.is_dir() else ():
        if _TEMPORARY.fullmatch(path.name):
            continue
        if not _STEP.fullmatch(path.name) or path.is_symlink() or not path.is_dir():
            raise ValueError(f"it holds {path.name[:40]!a}, which is not a checkpoint")
        steps.append(path)
    return max(steps, key=lambda path: int(path.name), default=None)


def require_whole(step: Path) -> bool:
    """Check that every file of a step is unchanged since it was written.

    Returns:
        False if the step has no digests because an earlier version wrote it.

    Raises:
        OSError: A file cannot be read.
        ValueError: A file is damaged, missing or foreign.
    """
    there = _files(step)
    if DIGESTS not in there:
        if EARLIER not in there:
            raise ValueError(f"{DIGESTS} is missing" if there else "it is empty")
        return False
    try:
        text = bounded_json.read_text(step / DIGESTS)
        digests = bounded_json.check(_SCHEMA, bounded_json.loads(text))
        if text != _rendered(digests):
            raise ValueError("it was modified")
    except ValueError as error:
        raise ValueError(f"{DIGESTS} is damaged: {error}") from None
    odd = sorted(digests.keys() ^ (there - {DIGESTS}))
    if odd:
        name = ascii(odd[0])[1:-1][:80]
        raise ValueError(f"{name} is {'missing but listed' if odd[0] in digests else 'not'} in {DIGESTS}")
    for name, digest in digests.items():
        if files.sha256(step / name) != digest:
            raise ValueError(f"{name} is damaged: its SHA-256 differs from the one in {DIGESTS}")
    return True


def _rendered(digests: dict[str, str]) -> str:
    return json.dumps(digests, indent=1) + "\n"


def _files(step: Path) -> set[str]:
    """Return the relative paths of all files in a folder; a symbolic link raises ValueError."""
    names: set[str] = set()
    for place, folders, found in os.walk(step):
        for name in (*folders, *found):
            path = Path(place, name)
            if path.is_symlink() or not (path.is_dir() or path.is_file()):
                raise ValueError(
                    f"{ascii(path.relative_to(step).as_posix())[1:-1][:80]} is not a regular file"
                )
        names |= {Path(place, name).relative_to(step).as_posix() for name in found}
        if len(names) > _MOST_FILES:
            raise ValueError(f"it holds more than {_MOST_FILES} files")
    return names


def _temporary(folder: Path, step: int) -> Path:
    return folder / f"{step}.{secrets.token_hex(8)}.tmp"


def _is_ours(name: str) -> bool:
    return bool(_STEP.fullmatch(name) or _STALE.fullmatch(name))


def _remove(paths) -> None:
    for path in list(paths):
        if path.is_symlink() or not path.is_dir():
            path.unlink()
        else:
            shutil.rmtree(path)


def _sync_all(folder: Path) -> None:
    for place, _, found in os.walk(folder, topdown=False):
        for name in found:
            _sync(Path(place, name))
        _sync(Path(place))


def _sync(path: Path) -> None:
    """Flush a path to disk, if the file system supports it."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in _UNSUPPORTED:
            raise
    finally:
        os.close(descriptor)
