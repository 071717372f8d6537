"""Reliable handling of requests to stop a command: SIGINT, SIGTERM and SIGHUP.

The first signal raises ``StoppedError`` in the main thread. This may have no effect: exceptions in callbacks
of a C library or the garbage collector are dropped, and the main thread may spend minutes in a computation.
The request is therefore also recorded: long work calls ``check()`` on every progress, and a thread, woken
immediately by Python's C handler, ends the process a few seconds later, or at a second signal.
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
"""Time for a clean shutdown, s. Files are written atomically, so nothing is lost if it is exceeded."""

_STOP = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_SETTLED = 0
"""Message that the previous signal was handled; no signal has this number."""

PARENT = "MJX_FIT_PARENT"
"""Environment variable with the id of the process that a command must not outlive."""


class StoppedError(KeyboardInterrupt):
    """Request to stop this process."""


class _Process:
    """State of this process, global since signal handlers take no arguments of their own."""

    asked: int | None = None
    kept = ""
    quiet = False
    waker = -1
    result: int | None = None
    ending = threading.Lock()


def install() -> None:
    """Install the signal handlers, except for signals that the parent process had set to be ignored."""
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
        _Process.quiet = True  # the parent reports it
        serve(int(os.environ.pop(PARENT)))


def follow(parent: int) -> None:
    """Stop this process when its parent has ended, for whatever reason."""

    def look() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=look, name="parent", daemon=True).start()


def serve(parent: int) -> None:
    """Make this process a worker of another one, which handles Ctrl-C and which it does not outlive."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    follow(parent)


def say_when_stopped(kept: str) -> None:
    """Set the words that describe what is kept if the command is stopped from here on."""
    _Process.kept = kept


def asked() -> bool:
    """True if the process was asked to stop."""
    return _Process.asked is not None


def check() -> None:
    """Raise a recorded request again in case it was dropped; long work calls this on every progress.

    Raises:
        StoppedError: The process was asked to stop.
    """
    if _Process.asked is not None:
        raise StoppedError


def settle() -> None:
    """Mark the request as handled, for example when it closed a viewer."""
    if _Process.asked is not None:
        _Process.asked = None
        os.write(_Process.waker, bytes([_SETTLED]))


def finished(result: int) -> None:
    """Record that the work is done, with its exit code; requests to stop now end the process immediately."""
    _Process.result = result


def _leave() -> None:
    """End a finished process before Python's own teardown, during which signals would kill it."""
    if _Process.result is not None:
        os._exit(_Process.result)


def end(done: bool = False) -> NoReturn:
    """Report the state of the work in one line, and exit with 128 plus the signal's number.

    The exit is immediate: XLA may still be compiling in its own thread, and a regular exit would crash in it.
    """
    with _Process.ending:  # never released: reported once
        for stream in (sys.stdout, sys.stderr):
            try:
                if stream is sys.stderr:
                    stream.write(_words(done))
                stream.flush()
            except (AttributeError, OSError, ValueError, RuntimeError):
                continue  # no stream, a closed one, or one in the middle of a write
        os._exit(_code(_Process.asked or signal.SIGINT))


def _end_from_outside(number: int) -> NoReturn:
    """End the process from another thread, without waiting for locks of the main thread, as on streams."""
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
    """Suppress Python's report of dropped requests to stop, since these are recorded."""

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
    """Wait for a signal, then for the process to end; end it after the grace period or at a second signal."""
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
