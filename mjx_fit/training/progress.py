"""How far a training is: a bar with the time left on a terminal, plain lines elsewhere."""

import time

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

SECONDS_BETWEEN_LINES = 10.0


class EpochProgress:
    """A context manager that is called with the metrics of each epoch."""

    def __init__(self, epochs_done: int, epochs: int):
        """Start at ``epochs_done`` of ``epochs``."""
        self.first, self.epochs = epochs_done, epochs
        self.started = time.monotonic()
        self.last_line = float("-inf")
        console = Console(stderr=True)
        self.bar = None
        if console.is_terminal:
            columns = (
                TextColumn("train"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.description}"),
            )
            self.bar = Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=console)
            self.task = self.bar.add_task("", total=epochs, completed=epochs_done)
        self.console = console

    def __enter__(self) -> "EpochProgress":
        """Show the bar."""
        if self.bar is not None:
            self.bar.start()
        return self

    def __exit__(self, *error) -> None:
        """Leave the bar as it is."""
        if self.bar is not None:
            self.bar.stop()

    def __call__(self, row: dict) -> None:
        """Note that an epoch is done."""
        text = f"val_nll {row['val_nll']:.3f} (prior {row['prior_nll']:.3f})"
        if self.bar is not None:
            self.bar.update(self.task, completed=row["epoch"] + 1, description=text)
            return
        now, done = time.monotonic(), row["epoch"] + 1
        if now - self.last_line >= SECONDS_BETWEEN_LINES or done == self.epochs:
            left_s = (now - self.started) / (done - self.first) * (self.epochs - done)
            self.console.print(
                f"train: epoch {done}/{self.epochs}, {text}, {left_s:.0f} s left", highlight=False
            )
            self.last_line = now
