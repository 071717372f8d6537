"""Marks above the holes that show a belief: where they are, how they stand, and what they are."""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Bool, Float

from mjx_fit.config.schema import Config
from mjx_fit.filters.frame import frame_of
from mjx_fit.filters.kalman import scale_tril
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.types import Belief
from mjx_fit.utils.type_colours import TYPE_RGB

UNSURE_RGB = (0.93, 0.93, 0.90)
RADIUS_90 = float(np.sqrt(4.605))
"""Radius of the 90 % region of a planar Gaussian, in standard deviations."""
STDS_90 = 1.645
"""Half width of the 90 % interval of one quantity, in standard deviations."""

_OVER_PLATE_M, _THICK_M, _DOT_M = 0.0015, 0.0006, 0.0018
_OVER_BELIEVED_M = 0.0065
"""Height of a mark over a plate whose height is only believed: it would else be inside of a higher one."""
_NEEDLE_M = 0.015
_ALPHA, _DARK, _PALE = 0.62, (0.1, 0.1, 0.1, 1.0), (0.1, 0.1, 0.1, 0.45)


@dataclass(frozen=True)
class Mark:
    """Geometry to add to the scene.

    Attributes:
        kind: Member of ``mujoco.mjtGeom``.
        size: MuJoCo size parameters of the kind, m.
        centre_world: Position of the centre, m.
        frame_world: Orientation, as a rotation matrix.
        rgba: Colour.
    """

    kind: Any
    size: Float[np.ndarray, "3"]
    centre_world: Float[np.ndarray, "3"]
    frame_world: Float[np.ndarray, "3 3"]
    rgba: tuple[float, float, float, float]


def marks_of(belief: Belief, empty: Bool[np.ndarray, "n"], config: Config) -> list[Mark]:
    """Return the marks of the empty holes, as they are believed to stand.

    Each has a thin disc, the 90 % region of its position, with its mean, in the colour of its type. Where a
    yaw is believed, a needle points along x, between the two ends of the yaw's 90 % interval.

    Args:
        belief: Belief about n holes.
        empty: Which of them are empty.
        config: Configuration.
    """
    return [
        mark
        for hole in np.flatnonzero(empty)
        for mark in _of_hole(jax.tree.map(lambda leaf, hole=hole: np.asarray(leaf)[hole], belief), config)
    ]


def _of_hole(belief: Belief, config: Config) -> list[Mark]:
    names, top = config.filter.coordinates, plate_top_m(config.scene)
    here = frame_of(belief.mean_world, names)
    turn = np.asarray(here.rotation_world.as_matrix(), float)
    over = jnp.array([*belief.pos_mean_world, top + (_OVER_BELIEVED_M if "z" in names else _OVER_PLATE_M)])
    centre = np.asarray(here.world(over, top), float)
    axes, stretch, _ = np.linalg.svd(np.asarray(scale_tril(jnp.asarray(belief.pos_cov))))
    planar = np.eye(3)
    planar[:2, :2] = axes * [1, np.sign(np.linalg.det(axes))]
    size = np.maximum([*(RADIUS_90 * stretch), _THICK_M], _THICK_M)
    disc = mujoco.mjtGeom.mjGEOM_ELLIPSOID
    found = [Mark(disc, size, centre, turn @ planar, (*mixed(np.exp(belief.type_logp)), _ALPHA))]
    dot = np.array([_DOT_M, 2 * _THICK_M, 0])
    found.append(Mark(mujoco.mjtGeom.mjGEOM_CYLINDER, dot, centre, turn, _DARK))
    if "yaw" not in names:
        return found
    yaw = names.index("yaw")
    off = STDS_90 * float(np.sqrt(belief.cov[yaw, yaw]))
    return [*found, *(_needle(centre, turn, by, _PALE if by else _DARK) for by in (0.0, -off, off))]


def _needle(
    centre: Float[np.ndarray, "3"],
    turn: Float[np.ndarray, "3 3"],
    yaw_rad: float,
    rgba: tuple[float, float, float, float],
) -> Mark:
    """Return a needle from the centre along x, turned by a yaw in the plane of the hole."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    frame = turn @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    size = np.array([_NEEDLE_M / 2, _THICK_M, _THICK_M])
    middle = centre + frame @ np.array([_NEEDLE_M / 2, 0, 2 * _THICK_M])
    return Mark(mujoco.mjtGeom.mjGEOM_ELLIPSOID, size, middle, frame, rgba)


def add(scene: mujoco.MjvScene, marks: list[Mark]) -> None:
    """Add marks to a MuJoCo scene."""
    for mark in marks:
        geom = scene.geoms[scene.ngeom]
        rgba = np.array(mark.rgba, np.float32)
        mujoco.mjv_initGeom(geom, mark.kind, mark.size, mark.centre_world, mark.frame_world.ravel(), rgba)
        scene.ngeom += 1


def mixed(chance: Float[np.ndarray, "C"]) -> tuple[float, float, float]:
    """Return the colour of a type belief: pale if uniform, the colour of the type if certain."""
    likely, even = int(np.argmax(chance)), 1 / len(chance)
    sure = (chance[likely] / chance.sum() - even) / (1 - even) if len(chance) > 1 else 1.0
    r, g, b = (1 - sure) * np.array(UNSURE_RGB) + sure * np.array(TYPE_RGB[likely])
    return float(r), float(g), float(b)
