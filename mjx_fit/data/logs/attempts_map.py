"""Part of a log's map: where attempts are, and what is known about each, before and afterwards."""

from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from mjx_fit.config.sections.fields import STRICT

Name = Annotated[str, Field(min_length=1, max_length=200)]
Source = Name | tuple[Name, ...]
"""A topic, an array or a feature; or the columns of a table, in order."""
Metres = Annotated[float, Field(ge=-10, le=10)]


@dataclass(frozen=True, config=STRICT)
class AttemptsMap:
    """Where attempts are, and what is known about each.

    Attributes:
        by: ``contact``: an attempt is a spell of contact with the free motion before it. ``column``: rows
            with the same number (or text) in a column, an array or a topic; none with a negative number or
            an empty text. ``file``: the log is one attempt.
        source: That column, array or topic.
        peg: Name of the peg's type.
        peg_source: Column, array or topic with the names of the pegs, instead of ``peg``.
        estimate: Where the hole was believed to be in the world: x and y, m, or a value for each coordinate
            of the belief, m and rad. None: where the attempt begins.
        estimate_source: The same for each attempt: columns, an array, a topic (``PointStamped``,
            ``Float64MultiArray``).
        tare_s: The tare is the mean of so long a rest before the attempt, s; None: of the free motion that
            comes before its contact.
    """

    by: Literal["contact", "column", "file"] = "contact"
    source: Name | None = None
    peg: Name | None = None
    peg_source: Name | None = None
    estimate: Annotated[tuple[Metres, ...], Field(min_length=2, max_length=6)] | None = None
    estimate_source: Source | None = None
    tare_s: Annotated[float, Field(ge=0.05, le=10)] | None = None

    def __post_init__(self) -> None:
        if (self.by == "column") != (self.source is not None):
            raise ValueError("source: it is needed with by: column, and with nothing else")
        for name in ("peg", "estimate"):
            if getattr(self, name) is not None and getattr(self, f"{name}_source") is not None:
                raise ValueError(f"{name}_source: it cannot be used with {name}")


@dataclass(frozen=True, config=STRICT)
class TruthMap:
    """What is known about each attempt afterwards; nothing of it goes into a belief, which it scores.

    Each is a value for all attempts, or a source of its own: a column, an array or a topic.

    Attributes:
        hole: Name of the hole's type.
        hole_source: The same for each attempt.
        place: Where the TCP is, x and y, when the peg is in the hole, in the library's world, m.
        place_source: The same for each attempt: columns, an array, a topic (``PointStamped``,
            ``Float64MultiArray``).
        inserted: Whether the peg went in.
        inserted_source: The same for each attempt: 0 or 1, false or true. The last value of an attempt
            counts, or else the first one after it, until the next begins.
    """

    hole: Name | None = None
    hole_source: Name | None = None
    place: tuple[Metres, Metres] | None = None
    place_source: Source | None = None
    inserted: bool | None = None
    inserted_source: Name | None = None

    def __post_init__(self) -> None:
        for name in ("hole", "place", "inserted"):
            if (getattr(self, name) is None) == (getattr(self, f"{name}_source") is None):
                raise ValueError(f"{name}: expected either {name} or {name}_source")
