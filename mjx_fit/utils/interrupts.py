"""A request to stop that cannot be lost: SIGINT, SIGTERM and SIGHUP of a command.

The first one raises ``StoppedError`` in the main thread. That may come to nothing: an exception in a callback
of a C library, or of the garbage collector, is dropped, and the main thread may be within a computation for
minutes. So the request is noted as well: long work asks ``check()`` whenever it gets on, and a thread, which
Python's own C handler wakes at once, ends the process a few seconds later, or at a second signal.
"""

import atexit
import contextlib
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable
from types import FrameType
from typing import NoReturn

GRACE_S = 5.0
"""Time to stop in order, s. Files are written whole or not at all, so nothing is lost without it."""

_STOP = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_SETTLED = 0
"""No signal has this number: it says that the one before was met."""

PARENT = "MJX_FIT_PARENT"
"""Variable that tells a command which process it must not outlive."""


class StoppedError(KeyboardInterrupt):
    """Somebody asked this process to stop."""


class _Process:
    """What is known of this process: a signal's handler can be given nothing."""

    asked: int | None = None
    kept = ""
    quiet = False
    waker = -1
    result: int | None = None
    ending = threading.Lock()


def install() -> None:
    """Takes the signals that ask to stop, but for those that whoever started this process had ignored."""
    if threading.current_thread() is not threading.main_thread():
        return
    taken = [number for number in _STOP if signal.getsignal(number) is not signal.SIG_IGN]
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    _Process.waker = writer
    threading.Thread(target=_watch, args=(reader, taken), name="interrupts", daemon=True).start()
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    sys.unraisablehook = _without_requests(sys.unraisablehook)
    for number in taken:
        signal.signal(number, _on_signal)
    atexit.register(_leave)  # registered first, called last
    if PARENT in os.environ:
        _Process.quiet = True  # the parent says it
        serve(int(os.environ.pop(PARENT)))


def follow(parent: int) -> None:
    """Lets this process stop when its parent is gone, however that ended."""

    def look() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=look, name="parent", daemon=True).start()


def serve(parent: int) -> None:
    """Makes this process a worker of another one: it leaves Ctrl-C to it, and does not outlive it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    follow(parent)


def say_when_stopped(kept: str) -> None:
    """Says what is kept when the command is stopped from here on."""
    _Process.kept = kept


def asked() -> bool:
    """Whether the process was asked to stop."""
    return _Process.asked is not None


def check() -> None:
    """Raises again what may have been lost; long work calls it whenever it gets on.

    Raises:
        StoppedError: The process was asked to stop.
    """
    if _Process.asked is not None:
        raise StoppedError


def settle() -> None:
    """The request was met: a viewer was closed by it, say."""
    if _Process.asked is not None:
        _Process.asked = None
        os.write(_Process.waker, bytes([_SETTLED]))


def finished(result: int) -> None:
    """Notes that the work is done, with this exit code; to ask for its end now ends the process at once."""
    _Process.result = result


def _leave() -> None:
    """Ends a process that is done before Python takes itself apart: signals would kill it meanwhile."""
    if _Process.result is not None:
        os._exit(_Process.result)


def end(done: bool = False) -> NoReturn:
    """Says in one line what became of the work, and ends the process with 128 and the signal's number.

    At once: XLA may still be compiling in a thread of its own, and an orderly exit would crash in it.
    """
    with _Process.ending:  # not released: it is said once
        for stream in (sys.stdout, sys.stderr):
            try:
                if stream is sys.stderr:
                    stream.write(_words(done))
                stream.flush()
            except (AttributeError, OSError, ValueError, RuntimeError):
                continue  # no stream, one that is closed, or one in the middle of a write
        os._exit(_code(_Process.asked or signal.SIGINT))


def _end_from_outside(number: int) -> NoReturn:
    """The same from another thread, which waits for nothing that the main thread holds, such as a stream."""
    if _Process.ending.acquire(timeout=1):
        with contextlib.suppress(OSError):
            os.write(2, _words(done=False).encode(errors="replace"))
    os._exit(_code(number))


def _words(done: bool) -> str:
    if _Process.quiet:
        return ""
    words = "asked to stop; the work was complete"
    if _Process.result is None:
        kept = "the work was complete" if done else _Process.kept
        words = "stopped" + f"; {kept}" * bool(kept)
    show_cursor = "\x1b[?25h" * os.isatty(2)  # a bar hides it
    return f"{show_cursor}mjx-fit: {words}\n"


def _code(number: int) -> int:
    return 128 + number if _Process.result is None else _Process.result


def _without_requests(hook: Callable) -> Callable:
    """Python reports exceptions that it drops; a request to stop is noted, and needs no report."""

    def unraisablehook(unraisable) -> None:
        if not issubclass(unraisable.exc_type, StoppedError):
            hook(unraisable)

    return unraisablehook


def _on_signal(number: int, frame: FrameType | None) -> None:
    if _Process.ending.locked():
        return
    if _Process.result is not None or _Process.asked is not None:
        end()
    _Process.asked = number
    raise StoppedError


def _watch(reader: int, taken: list[int]) -> None:
    """Waits for a signal, and then for the process to end; sees to its end at a second one."""
    while True:
        number = os.read(reader, 1)[0]
        if number not in taken:
            continue
        deadline, next_one = time.monotonic() + GRACE_S, number
        while (left := deadline - time.monotonic()) > 0:
            next_one = os.read(reader, 1)[0] if select.select([reader], [], [], left)[0] else number
            if next_one in taken or next_one == _SETTLED:
                break
        if next_one != _SETTLED:
            _end_from_outside(number)
