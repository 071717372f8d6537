"""Files that are written whole or not at all."""

import errno
import fcntl
import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import IO


def write_text(path: Path, text: str) -> None:
    """Writes a text file under a temporary name, syncs it, and renames it."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Writes a file under a temporary name, syncs it, and renames it."""
    replace_with(path, lambda temporary: temporary.write_bytes(content))


def replace_with(path: Path, write: Callable[[Path], object]) -> None:
    """Lets ``write`` make a file under a temporary name, syncs it, and renames it to ``path``.

    A kill at any moment leaves the old file or the new one, never a part of it. What fails leaves no
    temporary file behind: on a full disk it would be in the way.
    """
    make_folder(path.parent)
    temporary = path.with_name(f"{path.name}.tmp")
    try:
        write(temporary)
        _sync(temporary)
        temporary.replace(path)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            error.filename = error.filename or str(path)
        raise
    _sync(path.parent)


def make_folder(path: Path) -> None:
    """Makes a folder and those above it, and syncs their entries, so that what is in it cannot be lost."""
    if path.exists() and not path.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path))
    if not path.is_dir():
        make_folder(path.parent)
        path.mkdir(exist_ok=True)
        _sync(path.parent)


def lock(path: Path) -> IO[bytes]:
    """Takes a lock file for this process until it is closed or the process ends; the file stays.

    Raises:
        BlockingIOError: Another process holds it.
    """
    file = path.open("ab")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        raise
    return file


def holds(file: IO[bytes], path: Path) -> bool:
    """Whether a lock that was taken on a path still is the one that others would meet there."""
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False


def require_writable(path: Path) -> None:
    """Makes sure that a file can be written, and its folder with it.

    Raises:
        OSError: It cannot; the error names the path.
    """
    make_folder(path.parent)
    if not os.access(path.parent, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))


def sha256(path: Path) -> str:
    """Hexadecimal SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sha256_of(content: bytes) -> str:
    """Hexadecimal SHA-256 of what a file holds."""
    return hashlib.sha256(content).hexdigest()


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
