"""Locks on output: a command holds its folder, or the file it creates, until it ends."""

import errno
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mjx_fit.utils import files
from mjx_fit.utils.errors import RequestError, WorkError
from mjx_fit.utils.filesystem import NOT_ALLOWED, is_at, open_entry, try_lock

_GONE = {errno.ENOENT, errno.ENOTDIR, errno.ESTALE}
_READ_ONLY = {errno.EROFS, *NOT_ALLOWED}


class Hold:
    """Lock on ``place`` by the lock file ``path``, open as ``descriptor``; None without locks."""

    def __init__(self, place: Path, path: Path, descriptor: int | None):
        self.place, self.path, self.descriptor = place, path, descriptor

    def is_there(self) -> bool:
        """True if the place was neither removed nor replaced."""
        return self.descriptor is None or is_at(self.descriptor, self.path)

    def require(self) -> None:
        """Check that the place was neither removed nor replaced.

        Raises:
            WorkError: The place was removed or replaced.
        """
        if not self.is_there():
            raise WorkError(f"{self.place} was removed or replaced while this command was writing to it")


class _Mine(threading.local):
    """Locks held by this thread, by device and inode of their lock files."""

    def __init__(self):
        self.holds: dict[tuple[int, int], Hold] = {}


_mine = _Mine()


def require_all() -> None:
    """Check that no place held by this thread was removed or replaced.

    Raises:
        WorkError: A place was removed or replaced.
    """
    for hold in _mine.holds.values():
        hold.require()


@contextmanager
def holding(folder: Path, *, even_if_read_only: bool = False) -> Iterator[Hold]:
    """Lock a folder, which is created if missing, against all other processes.

    A thread may hold it several times, nested, since commands call others. The lock file is finally removed,
    and so is a created folder that is still empty.

    Args:
        folder: Folder to lock.
        even_if_read_only: Continue without a lock on read-only file systems, where finished results can still
            be read.

    Raises:
        RequestError: Another process holds the folder, or the folder or its lock file is a link that cannot
            be followed.
        WorkError: The folder was removed or replaced while it was held.
    """
    made = files.make_folder(folder)
    try:
        with _held(folder, folder / files.LOCK, even_if_read_only) as hold:
            yield hold
    finally:
        for one in reversed(made):
            with suppress(OSError):
                os.rmdir(one)


@contextmanager
def holding_file(path: Path) -> Iterator[Hold]:
    """Lock a file to be created, and its intermediate files, as ``holding`` does for a folder."""
    files.require_writable(path)
    with _held(path, path.with_name(f"{files.short(path.name)}{files.LOCK}"), False) as hold:
        yield hold


@contextmanager
def _held(place: Path, path: Path, even_if_read_only: bool) -> Iterator[Hold]:
    mine = _mine_at(path)
    if mine is not None:
        yield mine
        return
    descriptor = _take(place, path, even_if_read_only)
    hold = Hold(place, path, descriptor)
    if descriptor is None:
        yield hold
        return
    number = _number(os.fstat(descriptor))
    _mine.holds[number] = hold
    try:
        yield hold
    except OSError as error:
        if error.errno in _GONE:
            hold.require()
        raise
    finally:
        del _mine.holds[number]
        try:
            if hold.is_there():  # before it is released: later processes create a new one
                with suppress(OSError):
                    os.unlink(path)
        finally:
            os.close(descriptor)


def _mine_at(path: Path) -> Hold | None:
    try:
        return _mine.holds.get(_number(os.lstat(path)))
    except OSError:
        return None


def _take(place: Path, path: Path, even_if_read_only: bool) -> int | None:
    while True:
        descriptor = _open(place, path, even_if_read_only)
        if descriptor is None:
            return None
        try:
            locked = try_lock(descriptor, path)
            if locked is False:
                raise RequestError(f"--out: {place} is in use: another process is writing to it")
        except BaseException:
            os.close(descriptor)
            raise
        if locked and is_at(descriptor, path):
            return descriptor
        os.close(descriptor)  # its holder removed it between opening and locking
        if locked is None:
            with suppress(OSError):
                os.unlink(path)
            return None


def _open(place: Path, path: Path, even_if_read_only: bool) -> int | None:
    try:
        return open_entry(path, os.O_RDWR | os.O_CREAT)
    except OSError as error:
        if error.errno in _READ_ONLY and even_if_read_only:
            return None
        error.filename = str(place)
        raise


def _number(status: os.stat_result) -> tuple[int, int]:
    return status.st_dev, status.st_ino
