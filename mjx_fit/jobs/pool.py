"""Pools perform the parts of a job. A part is idempotent: done twice or elsewhere, it gives the same."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol, TypeVar

Piece = TypeVar("Piece")
Done = TypeVar("Done")

USER_MODULES = "mjx_fit_policy_"
"""Modules of these names are files of the user's, which workers elsewhere do not have."""

Tell = Callable[[int, str], None]
"""Callback with the units that are done in a part, and a short text."""


def as_it_is(done: Any) -> Any:
    """Store nothing: the result itself is what the driver needs."""
    return done


class Pool(Protocol):
    """Performs parts.

    Attributes:
        alone: Whether it performs one part at a time.
    """

    alone: bool

    def run(
        self,
        work: Callable[[Piece, Tell], Any],
        pieces: Mapping[str, Piece],
        tell: Tell,
        store: Callable[[Any], Done] = as_it_is,
    ) -> Iterator[tuple[str, Done]]:
        """Yield the name and the stored result of each part, in the order in which they are done.

        Args:
            work: Function of a piece; it may be called in other processes, and twice for a piece.
            pieces: Pieces by name, which messages use.
            tell: Progress within a part, where the pool knows of it; called now and then in any case.
            store: Function that writes a large result to storage, and returns what is small of it.

        Raises:
            RequestError: A part refuses its piece.
            WorkError: A part failed, or nobody can perform it.
        """
        ...


class Here:
    """Performs parts in this process, one after the other."""

    alone = True

    def run(
        self,
        work: Callable[[Piece, Tell], Any],
        pieces: Mapping[str, Piece],
        tell: Tell,
        store: Callable[[Any], Done] = as_it_is,
    ) -> Iterator[tuple[str, Done]]:
        """See ``Pool.run``."""
        for name, piece in pieces.items():
            yield name, store(work(piece, tell))
