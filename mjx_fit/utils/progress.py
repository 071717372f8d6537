"""Progress reports on stderr: a bar with the remaining time on a terminal, plain lines elsewhere.

A watchdog ends the process if the work stalls.
"""

import time

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from mjx_fit.utils import interrupts
from mjx_fit.utils.watchdog import Watchdog

SECONDS_BETWEEN_LINES = 5.0
COMPILING = "compiling: the first part takes longest"
"""Initial text for work whose first part may take minutes."""


class Progress:
    """Context manager that reports progress; call it with the amount done and a short text.

    Work within other work, such as an experiment within a sweep, keeps its watchdog, and says nothing.

    Args:
        name: Name of the work.
        total: Total amount of work.
        done: Amount done before.
        begins: Text shown before the first call.

    Attributes:
        done: Amount done before.
    """

    def __init__(self, name: str, total: int, done: int = 0, begins: str = ""):
        self._name, self._total, self.done, self._begins = name, total, done, begins
        self._watchdog = Watchdog(name)
        self._outer = Progress._current
        self._last_line = time.monotonic() - SECONDS_BETWEEN_LINES
        self._paced_from: tuple[float, int] | None = None
        self._console = Console(stderr=True, highlight=False, emoji=False)
        self._bar = None
        if self._console.is_terminal and self._outer is None:
            columns = (TextColumn(name), BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"))
            self._bar = Bar(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=self._console)
            self._task = self._bar.add_task("", total=total, completed=done)

    _current: "Progress | None" = None

    def __enter__(self) -> "Progress":
        Progress._current = self
        self._watchdog.__enter__()
        if self._bar is not None:
            self._bar.start()
        if self._begins:
            self(self.done, self._begins)
        return self

    def __exit__(self, *error) -> None:
        Progress._current = self._outer
        self._watchdog.__exit__(*error)
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, done: int, text: str = "") -> None:
        """Report that ``done`` of the total is complete.

        Raises:
            StoppedError: The process was asked to stop.
        """
        interrupts.check()
        self._watchdog.beat()
        if self._outer is not None:
            self._outer._watchdog.beat()
            return
        if self._bar is not None:
            self._bar.update(self._task, completed=done, description=text)
            return
        now = time.monotonic()
        # Exclude earlier work and the first part, which includes compilation, from the pace.
        if self._paced_from is None and done > self.done:
            self._paced_from = now, done
        if now - self._last_line < SECONDS_BETWEEN_LINES and done < self._total:
            return
        self._last_line = now
        words = [f"{self._name}: {done}/{self._total}", text, self._left(now, done)]
        self._console.print(", ".join(filter(None, words)), soft_wrap=True)

    def _left(self, now: float, done: int) -> str:
        if done >= self._total:
            return ""
        since, first = self._paced_from or (now, done)
        if done == first:
            return "time left unknown"
        return f"{(now - since) / (done - first) * (self._total - done):.0f} s left"
