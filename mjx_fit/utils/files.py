"""Atomic writing of files."""

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
"""Suffix of the lock file that a command holds while it writes."""

_TEMPORARY = re.compile(r"(.+?)(\.[0-9a-f]{8})?\.tmp", re.DOTALL)
_LONGEST = 230
"""Longest file name, bytes, to which a suffix can still be added: file systems allow 255."""
_SURELY_DEAD_S = 3600.0
"""Age at which a temporary file counts as abandoned if the file system has no locks, s."""


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 text file under a temporary name, sync it, and rename it."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file under a temporary name, sync it, and rename it."""
    with _placing(path) as (descriptor, _):
        write_all(descriptor, content)


def replace_with(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` fill an empty file under a temporary name, sync it, and rename it to ``path``.

    A kill at any time leaves either the old or the new file, never a partial one. Failures remove the
    temporary file, which would take up space on a full disk. The entry at ``path`` is replaced, even if it is
    a link. The temporary name is unpredictable, and the file is created exclusively.
    """
    with _placing(path) as (_, temporary):
        write(temporary)


def append_line(path: Path, line: str) -> None:
    """Append a line to a text file and sync it; on failure the file remains unchanged.

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
    """Write all bytes to an open file."""
    left = memoryview(content)
    while left:
        left = left[os.write(descriptor, left) :]


def make_folder(path: Path) -> list[Path]:
    """Create a folder and its parents, and sync their entries, so that its content cannot be lost.

    Returns:
        Folders that were created, outermost first.

    Raises:
        RequestError: The folder or one of its parents is a file or a dangling link.
    """
    if path.is_dir():
        return []
    refuse_dangling(path)
    if path.exists():
        raise RequestError(f"--out: {path} cannot be used: it is a file, expected a folder")
    made = make_folder(path.parent)
    with naming(path):
        path.mkdir(exist_ok=True)
    sync_folder(path.parent)
    return [*made, path]


def require_writable(path: Path) -> None:
    """Check that a file can be written, and create its folder.

    Raises:
        RequestError: The file is a dangling link, or its folder cannot be created.
        OSError: The folder is not writable; the error names the path.
    """
    refuse_dangling(path)
    make_folder(path.parent)
    if not os.access(path.parent, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))


def short(name: str) -> str:
    """Truncate a file name so that a suffix can be added."""
    return os.fsdecode(os.fsencode(name)[:_LONGEST])


def foreign(folder: Path, ours: Collection[str]) -> list[str]:
    """List the names in a folder, sorted, except ours and their temporary and lock files."""
    if not folder.is_dir():
        return []
    return sorted(name for name in os.listdir(folder) if name not in ours and not is_temporary(name, of=ours))


def is_temporary(name: str, of: Collection[str]) -> bool:
    """True for names of temporary or lock files of the given files, and of the folder's lock."""
    owners = {short(owner) for owner in of}
    found = _TEMPORARY.fullmatch(name)
    owner = found[1] if found is not None else name[: -len(LOCK)] if name.endswith(LOCK) else None
    return name == LOCK or owner in owners


def sha256(path: Path) -> str:
    """Compute the hexadecimal SHA-256 of a file."""
    with path.open("rb") as file, naming(path):
        return hashlib.file_digest(file, "sha256").hexdigest()


def sha256_of(content: bytes) -> str:
    """Compute the hexadecimal SHA-256 of a file's content."""
    return hashlib.sha256(content).hexdigest()


@contextmanager
def _placing(path: Path) -> Iterator[tuple[int, Path]]:
    """Create an empty temporary file next to the path, open and locked, that finally replaces it."""
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
    """Create a file with a unique name, open, and locked for the lifetime of its writer."""
    while True:
        temporary = path.with_name(f"{short(path.name)}.{secrets.token_hex(4)}.tmp")
        try:
            descriptor = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        except FileExistsError:
            continue
        except OSError as error:
            error.filename = str(path)
            raise
        # Another process may have removed it as abandoned before it was locked.
        if try_lock(descriptor, path) is not False and is_at(descriptor, temporary):
            return descriptor, temporary
        os.close(descriptor)


def _remove_dead(path: Path) -> None:
    """Remove temporary files of a path whose writer was killed, best effort."""
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
    elif not stat.S_ISDIR(status.st_mode):  # from an earlier version, or planted: links are not followed
        os.unlink(temporary)
