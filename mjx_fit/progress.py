"""How far long work is: a bar with the time left on a terminal, plain lines elsewhere. On stderr.

A watchdog ends the process when the work stands still.
"""

import time

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from mjx_fit.watchdog import Watchdog

SECONDS_BETWEEN_LINES = 5.0


class Progress:
    """A context manager; call it with what is done so far and a few words.

    Args:
        name: What the work is called.
        total: How much there is to do.
        done: How much was done before.
    """

    def __init__(self, name: str, total: int, done: int = 0):
        self._name, self._total, self._first = name, total, done
        self._watchdog = Watchdog(name)
        self._started = time.monotonic()
        self._last_line = self._started - SECONDS_BETWEEN_LINES
        self._console = Console(stderr=True, highlight=False)
        self._bar = None
        if self._console.is_terminal:
            columns = (TextColumn(name), BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"))
            self._bar = Bar(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=self._console)
            self._task = self._bar.add_task("", total=total, completed=done)

    def __enter__(self) -> "Progress":
        self._watchdog.__enter__()
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *error) -> None:
        self._watchdog.__exit__(*error)
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, done: int, text: str = "") -> None:
        """Shows that ``done`` of the total is done."""
        self._watchdog.beat()
        if self._bar is not None:
            self._bar.update(self._task, completed=done, description=text)
            return
        now = time.monotonic()
        if now - self._last_line < SECONDS_BETWEEN_LINES and done < self._total:
            return
        self._last_line = now
        passed = done - self._first
        left = (
            f"{(now - self._started) / passed * (self._total - done):.0f} s left" if passed else "just begun"
        )
        words = ", ".join(part for part in (text, left) if part)
        self._console.print(f"{self._name}: {done}/{self._total}, {words}", soft_wrap=True)
