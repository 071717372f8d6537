"""A training run: where it is, what makes it this run, and holding its folders while it trains."""

import inspect
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from mjx_fit.utils import files, locks
from mjx_fit.utils.errors import RequestError, require
from mjx_fit.utils.filesystem import path_inside

P = ParamSpec("P")
R = TypeVar("R")

MAX_MEMBERS = 100


@dataclass(frozen=True)
class Run:
    """Request for a training run.

    Attributes:
        out: Folder of the run.
        seed: Root seed of weights, split, windows and noise.
        members: Number of sensors; more than one form an ensemble, each with its own folder ``member-M``.
        init: Folder of another run whose best sensor provides the initial weights; None: new weights.
        inside: Subfolder of the run folder, or of each member's folder, for this training.
        tensorboard: Whether to write event files as well.
        member: Number of the first sensor in its ensemble, whose draws it has.
    """

    out: Path
    seed: int
    members: int = 1
    init: Path | None = None
    inside: str = ""
    tensorboard: bool = False
    member: int = 0

    def folders(self) -> list[Path]:
        """Return the folder of each member.

        Raises:
            RequestError: See ``members``.
        """
        return members(self.out, self.members, self.inside)


@dataclass(frozen=True)
class Lineage:
    """Origin of a trained sensor.

    Attributes:
        seed: Root seed.
        data: Fingerprint of the training data.
        origin: Record of the initial sensor; None: new weights.
    """

    seed: int
    data: str
    origin: dict[str, Any] | None = None


def require_members(count: int) -> None:
    """Check that the number of sensors is in range, from 1 to ``MAX_MEMBERS``.

    Raises:
        RequestError: The number is out of range.
    """
    require("--members", count, 1, MAX_MEMBERS)


def members(out: Path, count: int, inside: str = "") -> list[Path]:
    """Return the folders of the members of an ensemble, or the run folder itself for one sensor.

    Raises:
        RequestError: The number of members is out of range, or the folder holds foreign files.
    """
    require_members(count)
    if count == 1:
        return [_below(out, inside)]
    names = [f"member-{member}" for member in range(count)]
    foreign = files.foreign(out, {"checkpoints", "frame_by_frame", *names})
    if foreign:
        raise RequestError(
            f"--out: {out} cannot be used: it holds other files ({foreign[0]}); choose a new folder"
        )
    return [_below(path_inside(out, name), inside) for name in names]


def _below(out: Path, inside: str) -> Path:
    return path_inside(out, inside) if inside else out


def held(train: Callable[P, R]) -> Callable[P, R]:
    """Lock the folder of a run and of its members while the decorated function trains there.

    Args:
        train: Function with a parameter ``run``.

    Returns:
        The wrapped function. It raises a RequestError if another process trains in one of the folders, and
        a WorkError if a folder disappears.
    """
    signature = inspect.signature(train)

    @wraps(train)
    def trains(*args: P.args, **kwargs: P.kwargs) -> R:
        run = signature.bind(*args, **kwargs).arguments["run"]
        folders = [run.out, *run.folders()]
        with ExitStack() as stack:
            for folder in dict.fromkeys(folders):
                # A finished run may be read-only.
                stack.enter_context(locks.holding(folder, even_if_read_only=True))
            return train(*args, **kwargs)

    return trains
