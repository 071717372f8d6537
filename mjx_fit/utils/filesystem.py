"""What is asked of the file system: errors name their path, no link is followed, what it lacks is said once.

Network and container file systems may have no locks, or refuse to sync a folder. Work goes on there without.
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
    """Give every OSError that names no file the path at which it happened."""
    try:
        yield
    except OSError as error:
        error.filename = error.filename or str(path)
        raise


def open_entry(path: Path, flags: int) -> int:
    """Open an entry of a folder that is written to; a new file gets the permissions that the umask leaves.

    Args:
        path: The entry.
        flags: As of ``os.open``; a link is never followed, and a FIFO never waited for.

    Returns:
        The descriptor.

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
    """An entry of a folder that is written to, which is no symbolic link.

    Raises:
        RequestError: It is one.
    """
    refuse_link(folder / name)
    return folder / name


def refuse_link(path: Path) -> None:
    """Refuse a symbolic link where something is to be written.

    Raises:
        RequestError: The path is one.
    """
    if path.is_symlink():
        raise RequestError(
            f"--out: {path} cannot be used: it is a symbolic link, and none is followed in a folder that is "
            "written to; remove it"
        )


def refuse_dangling(path: Path) -> None:
    """Refuse a symbolic link that leads nowhere.

    Raises:
        RequestError: The path is one.
    """
    if path.is_symlink() and not os.path.exists(path):
        raise RequestError(
            f"--out: {path} cannot be used: it is a dangling link (to {os.readlink(path)}); remove it, or "
            "make what it points to"
        )


def try_lock(descriptor: int, path: Path) -> bool | None:
    """Lock an open file for this process.

    Returns:
        Whether it is locked now; False if another process holds it, None where there are no locks.
    """
    try:
        with naming(path):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in NO_LOCKS:
            raise
        _say_once(path.parent, "this file system has no locks", error, "let no second command write there")
        return None
    return True


def is_at(descriptor: int, path: Path) -> bool:
    """Whether an open file still is the one that others would meet at the path."""
    try:
        return os.path.samestat(os.fstat(descriptor), os.lstat(path))
    except OSError:
        return False


def sync(descriptor: int, path: Path) -> None:
    """Let what was written reach the disk, where the file system knows how."""
    try:
        with naming(path):
            os.fsync(descriptor)
    except OSError as error:
        if error.errno not in NO_SYNC:
            raise
        _say_once(path, "this file system cannot sync it", error, "a power failure may lose files")


def sync_folder(path: Path) -> None:
    """Let the names in a folder reach the disk, where the file system knows how."""
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
    """Make an open file so large, without gaps, where the system knows how: later there will be room.

    Raises:
        OSError: There is no room.
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
