"""File operations that fail, all of those below a folder, from a chosen one on."""

import errno
import os
from pathlib import Path


class Killed(BaseException):
    """Comes where SIGKILL would."""


class Faults:
    """Counts what changes files below a folder: making, writing, syncing, renaming (before, after), removing.

    A write that is to fail happens by half. With ``code`` 0 the process is dead from that moment on: nothing
    is tidied up. Else whatever needs room fails from then on with that error of the system, and no name.
    """

    def __init__(self, patch, root: Path, moment: int, code: int = 0):
        self.root, self.moment, self.code = os.fspath(root), moment, code
        self.count, self._open = 0, set()
        for name in ("open", "mkdir", "write", "fsync", "replace", "unlink", "rmdir"):
            patch.setattr(os, name, getattr(self, f"_{name}_")(getattr(os, name)))

    @property
    def failed(self) -> bool:
        return self.count > self.moment

    def _moment(self, first_half=lambda: None) -> None:
        self.count += 1
        if self.failed:
            if self.count == self.moment + 1:
                first_half()
            raise OSError(self.code, os.strerror(self.code)) if self.code else Killed

    def _is_ours(self, path) -> bool:
        return isinstance(path, str | os.PathLike) and os.fspath(path).startswith(self.root)

    def _open_(self, real):
        def opened(path, flags, *args, **kwargs):
            ours = self._is_ours(path)
            if ours and flags & os.O_CREAT:
                self._moment()
            descriptor = real(path, flags, *args, **kwargs)
            (self._open.add if ours else self._open.discard)(descriptor)
            return descriptor

        return opened

    def _mkdir_(self, real):
        def made(path, *args, **kwargs):
            if self._is_ours(path) and not os.path.isdir(path):
                self._moment()
            return real(path, *args, **kwargs)

        return made

    def _write_(self, real):
        def written(descriptor, content):
            if descriptor in self._open:
                self._moment(lambda: real(descriptor, content[: len(content) // 2]))
            return real(descriptor, content)

        return written

    def _fsync_(self, real):
        def synced(descriptor):
            if descriptor in self._open:
                self._moment()
            return real(descriptor)

        return synced

    def _replace_(self, real):
        def replaced(path, target, **kwargs):
            if self._is_ours(target):
                self._moment()
                real(path, target, **kwargs)
                if not self.code:
                    self._moment()
            else:
                real(path, target, **kwargs)

        return replaced

    def _removed(self, real):
        def removed(path, *args, **kwargs):
            if self._is_ours(path) and not self.code:
                if self.failed:
                    return None  # nothing is tidied up by what is dead
                self._moment()
            return real(path, *args, **kwargs)

        return removed

    _unlink_ = _rmdir_ = _removed


def without(patch, module, name: str, code: int) -> None:
    """A file system that answers locking (``fcntl.flock``) or syncing (``os.fsync``) with an error."""

    def refused(*_):
        raise OSError(code, os.strerror(code))

    patch.setattr(module, name, refused)


NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EMFILE, errno.EIO, errno.ESTALE)
