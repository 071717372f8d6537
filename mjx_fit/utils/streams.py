"""Standard streams that never raise, so that a command's work continues whatever the shell did to them.

This module handles closed streams (``>&-``), readers that exit (``| head -1``), full devices, encodings that
lack printed characters, and non-blocking pipes, independent of the content.
"""

import errno
import io
import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_failed: dict[int, OSError] = {}


class _Raw(io.FileIO):
    """File descriptor that drops what it cannot write, and records the error."""

    def write(self, content, /) -> int:
        size = memoryview(content).nbytes
        if self.fileno() in _failed:
            return size
        try:
            written = super().write(content)
            if written is None:  # full: another process made the shared pipe non-blocking
                select.select([], [self], [])
                return self.write(content)
        except (OSError, ValueError) as error:  # select limits descriptors
            _failed[self.fileno()] = error if isinstance(error, OSError) else OSError(str(error))
            return size
        return written


def prepare() -> None:
    """Make the standard streams of this process usable. Call it before any file is opened."""
    _open_closed()
    if sys.stdin is None:
        sys.stdin = io.TextIOWrapper(io.FileIO(0, closefd=False), encoding="utf-8")
    sys.stdout = sys.__stdout__ = _tolerant(sys.stdout, 1)
    sys.stderr = sys.__stderr__ = _tolerant(sys.stderr, 2)


def finish() -> OSError | None:
    """Flush the buffers.

    Returns:
        Error of writing to standard output; None if there was none, or if the reader exited.
    """
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    error = _failed.get(1)
    return None if error is None or error.errno in (errno.EPIPE, errno.ECONNRESET) else error


def _open_closed() -> None:
    """Open the null device in place of closed descriptors.

    Otherwise the next file would get the lowest free descriptor: data in a file opened as descriptor 1 would
    be mixed with printed text.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            null = os.open(os.devnull, os.O_RDWR)
            if null != number:
                os.dup2(null, number)
                os.close(null)
            os.set_inheritable(number, True)


def _tolerant(stream, number: int):
    if stream is None:
        encoding, line_buffering, write_through = "utf-8", True, False
    else:
        try:
            if stream.fileno() != number:
                return stream  # replaced by an embedding program
            stream.flush()
        except (OSError, ValueError, AttributeError):
            pass
        encoding = getattr(stream, "encoding", None) or "utf-8"
        line_buffering = getattr(stream, "line_buffering", True)
        write_through = getattr(stream, "write_through", False)
    raw = _Raw(number, "w", closefd=False)
    return io.TextIOWrapper(
        raw if write_through else io.BufferedWriter(raw),  # type: ignore[arg-type]  # as Python does
        encoding=encoding,
        errors="backslashreplace",
        line_buffering=line_buffering,
        write_through=write_through,
    )


@contextmanager
def native_output_silenced() -> Iterator[None]:
    """Discard what libraries in C write to the standard streams meanwhile."""
    sys.stdout.flush()
    sys.stderr.flush()
    kept = [os.dup(number) for number in (1, 2)]
    null = os.open(os.devnull, os.O_WRONLY)
    try:
        for number in (1, 2):
            os.dup2(null, number)
        yield
    finally:
        for number, own in zip((1, 2), kept, strict=True):
            os.dup2(own, number)
            os.close(own)
        os.close(null)
