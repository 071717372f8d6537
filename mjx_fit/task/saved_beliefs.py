"""JSON file with the beliefs of a tracker."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from pydantic import TypeAdapter

from mjx_fit.sensors.trained_sensor import TrainedSensor
from mjx_fit.types import Belief
from mjx_fit.utils import bounded_json, files
from mjx_fit.utils.errors import RequestError, shown

FORMAT = 1
GEOMETRY = "geometry of contact"
"""Fingerprint where the geometry of the parts reads, and no sensor."""
STORED = {"pos_mean_world": "mean_world", "pos_cov": "cov", "type_logp": "type_logp"}
"""Attributes of ``Belief`` by the names that they have in the file."""


def as_stored(belief: Belief) -> dict[str, Any]:
    """Return a belief as lists, by the names in the file."""
    return {stored: np.asarray(getattr(belief, name), float).tolist() for stored, name in STORED.items()}


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
        pos_mean_world: Mean place of each hole in the believed coordinates, m and rad, see ``Belief``.
        pos_cov: Covariance of each place, m² and rad².
        type_logp: Log type probabilities of each hole, ln ξ.
        detections: Where each hole was detected, m and rad; None, in older files: at its mean place.
    """

    format: int
    shapes: list[str]
    sensor: str
    peg: str | None
    filled: list[bool]
    tries: list[int]
    pos_mean_world: list[list[float]]
    pos_cov: list[list[list[float]]]
    type_logp: list[list[float]]
    detections: list[list[float]] | None = None

    def require_for(self, path: Path, sensor: TrainedSensor | None, shapes: Sequence[str]) -> None:
        """Check that the beliefs are those of a sensor and of shapes.

        Raises:
            RequestError: They are others', or do not have one entry for each hole.
        """
        for word, there, here in (
            ("sensor", self.sensor, fingerprint_of(sensor)),
            ("shapes", self.shapes, list(shapes)),
        ):
            if there != here:
                raise RequestError(
                    f"{path}: {word}: {shown(there)} cannot be used: this tracker has {shown(here)}"
                )
        n = len(self.pos_mean_world)
        if not len(self.filled) == len(self.tries) == n:
            raise RequestError(f"{path}: filled, tries: lengths are invalid: expected {n} entries each")

    def places(self, path: Path) -> Float[np.ndarray, "n D"] | Float[np.ndarray, "n 2"]:
        """Return where the holes were detected.

        Args:
            path: The file, for messages.

        Raises:
            RequestError: Lists have different lengths, or one is missing.
        """
        if self.detections is None:
            return np.array([mean[:2] for mean in self.pos_mean_world])
        try:
            places = np.asarray(self.detections, np.float32)
        except ValueError:
            raise RequestError(
                f"{path}: detections: lengths are invalid: expected the same in each row"
            ) from None
        n = len(self.pos_mean_world)
        if len(places) != n:
            raise RequestError(f"{path}: detections: {len(places)} are invalid: expected {n}, as holes")
        return places

    def belief(self, path: Path) -> Belief:
        """Return the belief; its values are still to be checked.

        Args:
            path: The file, for messages.

        Raises:
            RequestError: Lists have different lengths.
        """
        try:
            mean, cov, type_logp = (np.asarray(getattr(self, stored), np.float32) for stored in STORED)
            return Belief(mean, cov, type_logp)
        except ValueError:
            words = ", ".join(STORED)
            raise RequestError(
                f"{path}: {words}: lengths are invalid: expected the same in each row"
            ) from None


def fingerprint_of(sensor: TrainedSensor | None) -> str:
    """Return what tells the reader of a tracker's logs from others."""
    return GEOMETRY if sensor is None else sensor.fingerprint


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
