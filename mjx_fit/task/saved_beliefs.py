"""JSON file with the beliefs of a tracker."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from pydantic import TypeAdapter

from mjx_fit.utils import bounded_json, files
from mjx_fit.utils.errors import RequestError

FORMAT = 1
STORED = ("pos_mean_world", "pos_cov", "type_logp")
"""Fields that are attributes of ``Belief``."""


@dataclass(frozen=True)
class SavedBeliefs:
    """Content of a belief file.

    Attributes:
        format: Version of the file format, ``FORMAT``.
        shapes: Names of the hole types.
        sensor: Fingerprint of the sensor.
        peg: Shape of the peg in hand, if any.
        filled: Whether each hole is filled.
        tries: Number of failed attempts at each hole with that peg.
        pos_mean_world: Mean position of each hole, m, see ``Belief``.
        pos_cov: Position covariance of each hole, m².
        type_logp: Log type probabilities of each hole, ln ξ.
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
    """Write a belief file atomically."""
    files.write_text(path, json.dumps(asdict(beliefs), indent=1) + "\n")


def read_beliefs(path: Path) -> SavedBeliefs:
    """Read a belief file.

    Raises:
        RequestError: The file is unreadable, or it is not a belief file.
    """
    try:
        saved = bounded_json.check(TypeAdapter(SavedBeliefs), bounded_json.read(path))
    except OSError as error:
        raise RequestError(f"{path} cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise RequestError(f"{path} is not a belief file: {error}") from None
    if saved.format != FORMAT:
        raise RequestError(f"{path}: format: {saved.format} is invalid: expected {FORMAT}")
    return saved
