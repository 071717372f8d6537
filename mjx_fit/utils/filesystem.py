"""File system access: errors name their path, links are not followed, missing features are reported once.

Network and container file systems may lack locks, or refuse to sync a folder. Work continues there without.
"""

import errno
import fcntl
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mjx_fit.utils.errors import RequestError

NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP, errno.EINVAL, errno.EBADF}
NO_SYNC = {errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP, errno.EBADF}
NOT_ALLOWED = {errno.EACCES, errno.EPERM}

_said: set[str] = set()


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Add the path to every OSError that names no file."""
    try:
        yield
    except OSError as error:
        error.filename = error.filename or str(path)
        raise


def open_entry(path: Path, flags: int) -> int:
    """Open an entry of an output folder; new files get the permissions allowed by the umask.

    Args:
        path: Path of the entry.
        flags: Flags of ``os.open``; links are never followed, and opening a FIFO never blocks.

    Returns:
        File descriptor.

    Raises:
        RequestError: The entry is a symbolic link.
    """
    try:
        with naming(path):
            return os.open(path, flags | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK, 0o666)
    except OSError:
        refuse_link(path)
        raise


def path_inside(folder: Path, name: str) -> Path:
    """Return the path of an entry of an output folder, which must not be a symbolic link.

    Raises:
        RequestError: The entry is a symbolic link.
    """
    refuse_link(folder / name)
    return folder / name


def refuse_link(path: Path) -> None:
    """Refuse a symbolic link as an output path.

    Raises:
        RequestError: The path is a symbolic link.
    """
    if path.is_symlink():
        raise RequestError(
            f"--out: {path} cannot be used: it is a symbolic link, which is not followed in an output "
            "folder; remove it"
        )


def refuse_dangling(path: Path) -> None:
    """Refuse a dangling symbolic link.

    Raises:
        RequestError: The path is a dangling link.
    """
    if path.is_symlink() and not os.path.exists(path):
        raise RequestError(
            f"--out: {path} cannot be used: it is a dangling link (to {os.readlink(path)}); remove it, or "
            "create its target"
        )


def try_lock(descriptor: int, path: Path) -> bool | None:
    """Lock an open file for this process.

    Returns:
        True if it is locked now, False if another process holds it, None if the file system has no locks.
    """
    try:
        with naming(path):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in NO_LOCKS:
            raise
        _say_once(path.parent, "this file system has no locks", error, "run no second command there")
        return None
    return True


def is_at(descriptor: int, path: Path) -> bool:
    """True if an open file is still the one at the path."""
    try:
        return os.path.samestat(os.fstat(descriptor), os.lstat(path))
    except OSError:
        return False


def sync(descriptor: int, path: Path) -> None:
    """Sync an open file to disk, if the file system supports it."""
    try:
        with naming(path):
            os.fsync(descriptor)
    except OSError as error:
        if error.errno not in NO_SYNC:
            raise
        _say_once(path, "this file system cannot sync it", error, "a power failure may lose files")


def sync_folder(path: Path) -> None:
    """Sync the entries of a folder to disk, if the file system supports it."""
    try:
        with naming(path):
            descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError as error:
        if error.errno not in NOT_ALLOWED:
            raise
        _say_once(path, "this folder cannot be synced", error, "a power failure may lose files")
        return
    try:
        sync(descriptor, path)
    finally:
        os.close(descriptor)


def reserve(descriptor: int, size: int) -> None:
    """Reserve disk space for an open file, if the system supports it, so that later writes have room.

    Raises:
        OSError: The disk is full.
    """
    if not hasattr(os, "posix_fallocate"):
        return
    try:
        os.posix_fallocate(descriptor, 0, size)
    except OSError as error:
        if error.errno not in NO_SYNC:
            raise


def _say_once(path: Path, what: str, error: OSError, so: str) -> None:
    if what not in _said and sys.stderr is not None:
        print(f"mjx-fit: {path}: {what} ({error.strerror}); {so}", file=sys.stderr)
    _said.add(what)
