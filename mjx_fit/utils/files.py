"""Files that are written whole or not at all."""

import errno
import hashlib
import os
import re
import secrets
import stat
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.filesystem import is_at, naming, open_entry, refuse_dangling, sync, sync_folder, try_lock

LOCK = ".lock"
"""End of the name of a file that a command locks while it writes."""

_TEMPORARY = re.compile(r"(.+?)(\.[0-9a-f]{8})?\.tmp", re.DOTALL)
_LONGEST = 230
"""Bytes of a name that are kept where more is added to it: file systems allow 255."""
_SURELY_DEAD_S = 3600.0
"""Age of a temporary file that nobody writes any more, where no lock can say so."""


def write_text(path: Path, text: str) -> None:
    """Writes a text file, in UTF-8, under a temporary name, syncs it, and renames it."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Writes a file under a temporary name, syncs it, and renames it."""
    with _placing(path) as (descriptor, _):
        write_all(descriptor, content)


def replace_with(path: Path, write: Callable[[Path], object]) -> None:
    """Lets ``write`` fill an empty file under a temporary name, syncs it, and renames it to ``path``.

    A kill at any moment leaves the old file or the new one, never a part of it. What fails leaves no
    temporary file: on a full disk it would be in the way. Whatever is at the path, a link too, is replaced as
    an entry of its folder. The temporary name is unpredictable, and made exclusively.
    """
    with _placing(path) as (_, temporary):
        write(temporary)


def append_line(path: Path, line: str) -> None:
    """Adds a line to a text file and syncs it; if that fails, the file stays as it was.

    Raises:
        RequestError: The file is a symbolic link.
    """
    descriptor = open_entry(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    size = os.fstat(descriptor).st_size
    try:
        with naming(path):
            write_all(descriptor, f"{line}\n".encode())
        sync(descriptor, path)
    except BaseException:
        with suppress(OSError):
            os.ftruncate(descriptor, size)
        raise
    finally:
        os.close(descriptor)


def write_all(descriptor: int, content: bytes) -> None:
    """Writes all of it to an open file."""
    left = memoryview(content)
    while left:
        left = left[os.write(descriptor, left) :]


def make_folder(path: Path) -> list[Path]:
    """Makes a folder and those above it, and syncs their entries, so that what is in it cannot be lost.

    Returns:
        The folders that were not there before, from the outermost.

    Raises:
        RequestError: The folder, or one above it, is a file or a dangling link.
    """
    if path.is_dir():
        return []
    refuse_dangling(path)
    if path.exists():
        raise RequestError(f"--out: {path} cannot be used: it is a file, and must be a folder")
    made = make_folder(path.parent)
    with naming(path):
        path.mkdir(exist_ok=True)
    sync_folder(path.parent)
    return [*made, path]


def require_writable(path: Path) -> None:
    """Makes sure that a file can be written, and its folder with it.

    Raises:
        RequestError: It is a dangling link, or its folder cannot be one.
        OSError: It cannot; the error names the path.
    """
    refuse_dangling(path)
    make_folder(path.parent)
    if not os.access(path.parent, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))


def short(name: str) -> str:
    """A file's name, cut so that an ending can be added to it."""
    return os.fsdecode(os.fsencode(name)[:_LONGEST])


def foreign(folder: Path, ours: Collection[str]) -> list[str]:
    """Names in a folder, sorted, that are neither ours nor what a kill, or another process, left of them."""
    if not folder.is_dir():
        return []
    return sorted(name for name in os.listdir(folder) if name not in ours and not is_temporary(name, of=ours))


def is_temporary(name: str, of: Collection[str]) -> bool:
    """Whether a name is that of a temporary or lock file of one of these, or of the folder's lock."""
    owners = {short(owner) for owner in of}
    found = _TEMPORARY.fullmatch(name)
    owner = found[1] if found is not None else name[: -len(LOCK)] if name.endswith(LOCK) else None
    return name == LOCK or owner in owners


def sha256(path: Path) -> str:
    """Hexadecimal SHA-256 of a file."""
    with path.open("rb") as file, naming(path):
        return hashlib.file_digest(file, "sha256").hexdigest()


def sha256_of(content: bytes) -> str:
    """Hexadecimal SHA-256 of what a file holds."""
    return hashlib.sha256(content).hexdigest()


@contextmanager
def _placing(path: Path) -> Iterator[tuple[int, Path]]:
    """An empty temporary file beside the path, open and locked, which takes its place in the end."""
    make_folder(path.parent)
    with naming(path):
        _remove_dead(path)
        descriptor, temporary = _create(path)
    try:
        yield descriptor, temporary
        sync(descriptor, path)
        os.replace(temporary, path)
    except BaseException as error:
        with suppress(OSError):
            os.unlink(temporary)
        if isinstance(error, OSError) and error.filename in (None, str(temporary)):
            error.filename, error.filename2 = str(path), None
        raise
    finally:
        os.close(descriptor)
    sync_folder(path.parent)


def _create(path: Path) -> tuple[int, Path]:
    """A new file with a name of its own: open, and locked for as long as its writer lives."""
    while True:
        temporary = path.with_name(f"{short(path.name)}.{secrets.token_hex(4)}.tmp")
        try:
            descriptor = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        except FileExistsError:
            continue
        except OSError as error:
            error.filename = str(path)
            raise
        # Another process may have taken it for a dead one before it was locked.
        if try_lock(descriptor, path) is not False and is_at(descriptor, temporary):
            return descriptor, temporary
        os.close(descriptor)


def _remove_dead(path: Path) -> None:
    """Removes temporary files of a path whose writer was killed, best effort."""
    with suppress(PermissionError):
        for name in os.listdir(path.parent):
            found = _TEMPORARY.fullmatch(name)
            if found is not None and found[1] == short(path.name):
                with suppress(OSError):
                    _remove_if_dead(path.with_name(name), is_locked=found[2] is not None)


def _remove_if_dead(temporary: Path, is_locked: bool) -> None:
    status = os.lstat(temporary)
    if is_locked and stat.S_ISREG(status.st_mode):
        descriptor = os.open(temporary, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK)
        try:
            free = try_lock(descriptor, temporary)
            if free or (free is None and time.time() - status.st_mtime > _SURELY_DEAD_S):
                os.unlink(temporary)
        finally:
            os.close(descriptor)
    elif not stat.S_ISDIR(status.st_mode):  # of an earlier version, or planted: a link is not followed
        os.unlink(temporary)
