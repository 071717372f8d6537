"""Scores of believed places against the truth: distance, angle, and calibration; symmetric parts look alike.

A socket with an n-fold symmetry has n poses that nothing can tell apart: the error of its yaw is the smallest
one. A round socket has no yaw, and is scored by the other coordinates alone.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.evaluation.result_file import rounded
from mjx_fit.evaluation.scores import squared_mahalanobis
from mjx_fit.filters import chart
from mjx_fit.filters.frame import is_world
from mjx_fit.filters.kalman import CM_PER_M
from mjx_fit.scene.fits import is_round, symmetry
from mjx_fit.scene.outline import hole_outline


@dataclass(frozen=True)
class PlaceScores:
    """Scores of n trials after each of K attempts.

    Attributes:
        distance_cm: Distance of the mean from the true place, cm.
        turn_deg: Angle of the rotation between them, degrees; None: no rotation is believed.
        yaw_deg: Its part about the vertical; NaN where the hole has none; None: no yaw is believed.
        squared: Squared Mahalanobis distance of the truth.
        degrees: Number of coordinates that count, the degrees of freedom of ``squared``.
    """

    distance_cm: Float[np.ndarray, "n K"]
    turn_deg: Float[np.ndarray, "n K"] | None
    yaw_deg: Float[np.ndarray, "n K"] | None
    squared: Float[np.ndarray, "n K"]
    degrees: Int[np.ndarray, "n"]


def score_places(
    mean_world: Float[np.ndarray, "n K D"],
    cov: Float[np.ndarray, "n K D D"],
    place_world: Float[np.ndarray, "n #K D"],
    hole_type: Int[np.ndarray, "n"],
    config: Config,
) -> PlaceScores:
    """Score beliefs.

    Args:
        mean_world: Means, m and rad.
        cov: Covariances, m² and rad².
        place_world: True places (``place_for_tool``), of each belief, or one for all.
        hole_type: Types of the holes.
        config: Defines coordinates and parts.
    """
    names = config.filter.coordinates
    error, degrees = place_world - mean_world, np.full(len(place_world), len(names))
    if is_world(names):
        return PlaceScores(_distance(error), None, None, _squared(error, cov), degrees)
    error = np.array(chart.step_between(jnp.asarray(mean_world), jnp.asarray(place_world), names))
    turns = [i for i, name in enumerate(names) if name in chart.AXIS]
    squared, yaw_deg = None, None
    if "yaw" in names:
        yaw, orders = names.index("yaw"), np.array(symmetries(config.scene))[hole_type]
        no_yaw, period = orders == 0, 2 * np.pi / np.maximum(orders, 1)[:, None]
        error[..., yaw] = (error[..., yaw] + period / 2) % period - period / 2
        error[no_yaw, :, yaw] = 0
        rest = [i for i in range(len(names)) if i != yaw]
        without = _squared(error[..., rest], cov[..., rest, :][..., rest])
        squared = np.where(no_yaw[:, None], without, _squared(error, cov))
        degrees = degrees - no_yaw
        yaw_deg = np.where(no_yaw[:, None], np.nan, np.rad2deg(np.abs(error[..., yaw])))
    return PlaceScores(
        distance_cm=_distance(np.delete(error, turns, axis=-1)),
        turn_deg=np.rad2deg(np.linalg.norm(error[..., turns], axis=-1)) if turns else None,
        yaw_deg=yaw_deg,
        squared=_squared(error, cov) if squared is None else squared,
        degrees=degrees,
    )


def place_columns(scores: PlaceScores, i: int) -> dict[str, Any]:
    """Return the columns of a trial's row, with those of rotations that are believed and exist."""
    columns: dict[str, Any] = {"error_cm": rounded(scores.distance_cm[i])}
    if scores.turn_deg is not None:
        columns["turn_deg"] = rounded(scores.turn_deg[i])
    if scores.yaw_deg is not None and not np.isnan(scores.yaw_deg[i]).any():
        columns["yaw_deg"] = rounded(scores.yaw_deg[i])
    columns["squared_mahalanobis"] = rounded(scores.squared[i])
    if scores.degrees[i] != 2:
        columns["degrees"] = int(scores.degrees[i])
    return columns


def rotation_errors(trials: Sequence[Mapping[str, Any]]) -> dict[str, Float[np.ndarray, "n *K"]]:
    """Return the errors of rotation in trials, degrees, by metric; NaN where a hole has no yaw."""
    if "turn_deg" not in trials[0]:
        return {}
    turn = np.array([trial["turn_deg"] for trial in trials])
    yaw = np.array([trial.get("yaw_deg", np.full(turn.shape[1:], np.nan)) for trial in trials])
    return {"turn_error_deg": turn} | ({} if np.isnan(yaw).all() else {"yaw_error_deg": yaw})


@lru_cache(maxsize=16)
def symmetries(scene: SceneConfig) -> tuple[int, ...]:
    """Return for each shape how many yaws leave its hole as it is; 0: all."""
    holes = [hole_outline(shape, scene) for shape in scene.shapes]
    return tuple(0 if is_round(hole) else symmetry(hole) for hole in holes)


def _distance(error: Float[np.ndarray, "n K k"]) -> Float[np.ndarray, "n K"]:
    return CM_PER_M * np.linalg.norm(error, axis=-1)


def _squared(
    error: Float[np.ndarray, "n K k"], cov: Float[np.ndarray, "n K k k"]
) -> Float[np.ndarray, "n K"]:
    k = error.shape[-1]
    return squared_mahalanobis(error.reshape(-1, k), cov.reshape(-1, k, k)).reshape(error.shape[:2])
