"""What is wrong with a log, in one line each, with the time at which it was seen."""

from dataclasses import dataclass
from typing import Literal

Severity = Literal["refused", "left out", "repaired", "noted"]
"""The whole log cannot be used; an attempt, or samples, are left out; samples are changed; all is used."""


@dataclass(frozen=True)
class Finding:
    """One line about a log.

    Attributes:
        severity: What it means for the import.
        what: The line, without the time.
        at_s: Time in the log at which it was seen first, s; None: it is about the whole log.
    """

    severity: Severity
    what: str
    at_s: float | None = None

    def __str__(self) -> str:
        at = "" if self.at_s is None else f" at {self.at_s:.3f} s"
        return f"{self.severity}{at}: {self.what}"
