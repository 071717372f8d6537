"""The file that a tracker keeps its beliefs in: JSON."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from pydantic import TypeAdapter

from mjx_fit.utils import bounded_json, files
from mjx_fit.utils.errors import RequestError

FORMAT = 1


@dataclass(frozen=True)
class SavedBeliefs:
    """The content of a file of beliefs.

    Attributes:
        format: ``FORMAT``.
        shapes: Names of the types.
        sensor: Fingerprint of the sensor.
        peg: Name of the shape in hand, if any.
        filled: Which holes are.
        tries: Attempts that failed at each hole with that peg.
        pos_mean_world: As in ``Belief``, likewise the others.
        pos_cov: m².
        type_logp: ln ξ.
    """

    format: int
    shapes: list[str]
    sensor: str
    peg: str | None
    filled: list[bool]
    tries: list[int]
    pos_mean_world: list[tuple[float, float]]
    pos_cov: list[tuple[tuple[float, float], tuple[float, float]]]
    type_logp: list[list[float]]


def write_beliefs(path: Path, beliefs: SavedBeliefs) -> None:
    """Write a file of beliefs, whole or not at all."""
    files.write_text(path, json.dumps(asdict(beliefs), indent=1) + "\n")


def read_beliefs(path: Path) -> SavedBeliefs:
    """Read a file of beliefs.

    Raises:
        RequestError: It cannot be read, or is none.
    """
    try:
        saved = bounded_json.check(TypeAdapter(SavedBeliefs), bounded_json.read(path))
    except OSError as error:
        raise RequestError(f"{path} cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise RequestError(f"{path} is no file of beliefs: {error}") from None
    if saved.format != FORMAT:
        raise RequestError(f"{path}: format: {saved.format} is invalid: expected {FORMAT}")
    return saved
