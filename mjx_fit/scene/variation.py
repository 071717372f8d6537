"""Models of worlds with their own friction, contact, clearance or part size: what differs, and by how much.

The boxes of pegs and sockets are linear in clearance and scale as long as the order of their edges stays, so
the geometry of any world is that of the configured scene plus two multiples of fixed arrays. A test compares
it with compiled models, and ``require_linear`` refuses ranges over which the order changes.
"""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from jaxtyping import Float, Int

from mjx_fit.config.randomized import distributions
from mjx_fit.config.schema import Config
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.scene.build import Scene
from mjx_fit.scene.pieces import MakePieces, padded, peg_pieces, socket_pieces
from mjx_fit.types import Array
from mjx_fit.types.physics import Physics
from mjx_fit.utils.errors import RequestError

CONTACT = ("friction", "contact_time_s", "contact_damping")
"""Quantities of all contacts of a world."""
_STEPS = {"clearance_m": 1e-6, "part_scale": 1e-4}
GEOMETRY = tuple(_STEPS)
"""Quantities that change positions and sizes of boxes."""
_MAKERS: tuple[MakePieces, MakePieces] = (peg_pieces, socket_pieces)
_TOLERANCE_M = 1e-7

Boxes = Float[np.ndarray, "shapes boxes 6"]
"""Centre and half size of the boxes of all pegs, or of all sockets, m."""


@dataclass(frozen=True)
class Slope:
    """Derivatives of the geometry of all models with respect to one quantity, in metres per unit.

    Attributes:
        pos: Derivative of ``geom_pos``.
        size: Derivative of ``geom_size``.
    """

    pos: Float[np.ndarray, "pairs geoms 3"]
    size: Float[np.ndarray, "pairs geoms 3"]


def longest_contact_times(scene: SceneConfig) -> Float[np.ndarray, "pairs"]:
    """Return the longest time constant of each pair's contact, s: draws beyond it do not count."""
    limits = [scene.contact_time_limit_of(shape) for shape in scene.shapes]
    return np.minimum.outer(limits, limits).ravel()


def slopes(scene: Scene) -> dict[str, Slope]:
    """Compute the derivatives with respect to each quantity in ``GEOMETRY``.

    Raises:
        RequestError: A gap of a shape opens or closes at the configured clearance.
    """
    found = {}
    for name in GEOMETRY:
        rates = (_rate(make, scene.config, name) for make in _MAKERS)
        both = [_by_geom(scene, peg, hole) for peg, hole in product(*rates)]
        pos, size = np.split(np.stack(both), 2, axis=-1)
        found[name] = Slope(pos, size)
    return found


def require_drawable(config: Config) -> None:
    """Check that worlds can have the geometry that ``randomize`` draws.

    Raises:
        RequestError: As in ``require_linear``.
    """
    drawn = distributions(config.randomize, GEOMETRY)
    require_linear(config.scene, {name: one.support for name, one in drawn.items()}, "config: randomize")


def require_linear(scene: SceneConfig, ranges: dict[str, tuple[float, float]], field: str) -> None:
    """Check that the boxes keep the order of their edges over ranges of quantities in ``GEOMETRY``.

    Args:
        scene: Configuration of the scene.
        ranges: Smallest and largest value of each quantity that is drawn, by name.
        field: Section of the quantities in messages.

    Raises:
        RequestError: A gap of a shape opens or closes in between.
    """
    own = [shape.name for shape in scene.shapes if shape.clearance_m is not None]
    if own and "clearance_m" in ranges:
        raise RequestError(
            f"{field}.clearance_m cannot be drawn: {', '.join(own)}: they have a clearance_m of their own"
        )
    at = _values_at(scene)
    for make, ends in product(_MAKERS if ranges else (), product(*ranges.values())):
        changes = dict(zip(ranges, ends, strict=True))
        there = _boxes(make, scene, at | changes)
        base = _boxes(make, scene, at)
        for name, value in changes.items():
            base = base + (value - at[name]) * _rate(make, scene, name)
        if there.shape != base.shape or abs(there - base).max() > _TOLERANCE_M:
            values = ", ".join(f"{value:.6g}" for value in ends)
            raise _changes_order(f"{field}.{' and '.join(ranges)}: {values}", scene)


def _values_at(scene: SceneConfig) -> dict[str, float]:
    """Return the configured value of each quantity in ``GEOMETRY``."""
    return {"clearance_m": scene.clearance_m, "part_scale": 1.0}


def _boxes(make: MakePieces, scene: SceneConfig, values: dict[str, float]) -> Boxes:
    other = replace(scene, clearance_m=float(values["clearance_m"]))
    parts = padded(make, other, float(values["part_scale"]))
    boxes = [[piece.box for piece in pieces] for pieces in parts]
    if any(box is None for row in boxes for box in row):
        raise RequestError(
            f"config: randomize: {' and '.join(GEOMETRY)} cannot be drawn: a shape has sides that are not "
            "along the axes"
        )
    return np.array([[np.concatenate(box) for box in row if box is not None] for row in boxes])


def _rate(make: MakePieces, scene: SceneConfig, name: str) -> Boxes:
    """Return the derivative of the boxes with respect to a quantity, by a finite difference."""
    at, step = _values_at(scene), _STEPS[name]
    if name == "clearance_m" and at[name] > 0.001:
        step = -step  # stay in the allowed range
    before, after = (_boxes(make, scene, values) for values in (at, at | {name: at[name] + step}))
    if before.shape != after.shape:
        raise _changes_order(f"config: randomize.{name}", scene)
    return (after - before) / step


def _changes_order(what: str, scene: SceneConfig) -> RequestError:
    return RequestError(
        f"{what} cannot be used: a gap of a shape opens or closes on the way from scene.clearance_m "
        f"{scene.clearance_m} and scale 1"
    )


def _by_geom(scene: Scene, peg: Float[np.ndarray, "n 6"], hole: Float[np.ndarray, "m 6"]) -> np.ndarray:
    """Arrange the derivatives of one peg and one socket by geom (geoms, 6); those of others are zero."""
    rates = np.zeros((scene.models[0].ngeom, 6))
    for prefix, own in (("peg_", peg), ("hole_", hole)):
        rates[box_ids(scene, prefix, len(own))] = own
    return rates


def box_ids(scene: Scene, prefix: str, count: int) -> Int[np.ndarray, "n"]:
    """Return the ids of the geoms ``prefix0``, ``prefix1`` and so on."""
    return np.array([scene.models[0].geom(f"{prefix}{i}").id for i in range(count)])


def offsets(scene: Scene, physics: Physics) -> dict[str, Array]:
    """Return how far the drawn geometric quantities are from the scene's, by name, (n,)."""
    drawn = {name: getattr(physics, name) for name in GEOMETRY}
    at = _values_at(scene.config)
    return {name: value - at[name] for name, value in drawn.items() if value is not None}
