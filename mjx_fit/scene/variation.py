"""Models of worlds with their own friction, contact, clearance or part size: what differs, and by how much.

The boxes of pegs and sockets are linear in clearance and scale as long as the order of their edges stays, so
the geometry of any world is that of the configured scene plus two multiples of fixed arrays. A test compares
it with compiled models.
"""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from jaxtyping import Float, Int

from mjx_fit.scene.build import MakeBoxes, Scene, padded_boxes
from mjx_fit.scene.parts import hole_boxes, peg_boxes
from mjx_fit.types import Array
from mjx_fit.types.physics import Physics

_STEP_M, _STEP_SCALE = 1e-4, 0.01
CONTACT = ("friction", "contact_time_s", "contact_damping")
"""Quantities of all contacts of a world."""
GEOMETRY = ("clearance_m", "part_scale")
"""Quantities that change positions and sizes of boxes."""


@dataclass(frozen=True)
class Slope:
    """Derivatives of the geometry of all models with respect to one quantity, in metres per unit.

    Attributes:
        pos: Derivative of ``geom_pos``.
        size: Derivative of ``geom_size``.
    """

    pos: Float[np.ndarray, "pairs geoms 3"]
    size: Float[np.ndarray, "pairs geoms 3"]


def slopes(scene: Scene) -> dict[str, Slope]:
    """Compute the derivatives with respect to each quantity in ``GEOMETRY``."""
    config = scene.config
    down = config.clearance_m > 2 * _STEP_M  # stay in the allowed range
    step = -_STEP_M if down else _STEP_M
    other = replace(config, clearance_m=config.clearance_m + step)
    changed = {"clearance_m": ((other, 1.0), step), "part_scale": ((config, 1 + _STEP_SCALE), _STEP_SCALE)}
    found = {}
    for name, ((there, scale), step) in changed.items():
        parts = [
            [
                ((a.centre - b.centre) / step, (a.half - b.half) / step)
                for a, b in zip(padded_boxes(make, there, scale), padded_boxes(make, config), strict=True)
            ]
            for make in _MAKERS
        ]
        both = [_arrays(scene, peg, hole) for peg, hole in product(*parts)]
        found[name] = Slope(*(np.stack(arrays) for arrays in zip(*both, strict=True)))
    return found


_MAKERS: tuple[MakeBoxes, MakeBoxes] = (peg_boxes, hole_boxes)


def _arrays(scene: Scene, peg, hole) -> tuple[Float[np.ndarray, "geoms 3"], Float[np.ndarray, "geoms 3"]]:
    """Arrange the derivatives of one peg and one socket by geom; those of all other geoms are zero."""
    model = scene.models[0]
    pos, size = np.zeros((model.ngeom, 3)), np.zeros((model.ngeom, 3))
    for prefix, (centre, half) in (("peg_box", peg), ("hole_box", hole)):
        ids = box_ids(scene, prefix, len(centre))
        pos[ids], size[ids] = centre, half
    return pos, size


def box_ids(scene: Scene, prefix: str, count: int) -> Int[np.ndarray, "n"]:
    """Return the ids of the geoms ``prefix0``, ``prefix1`` and so on."""
    return np.array([scene.models[0].geom(f"{prefix}{i}").id for i in range(count)])


def offsets(scene: Scene, physics: Physics) -> dict[str, Array]:
    """Return how far the drawn geometric quantities are from the scene's, by name, (n,)."""
    at = {"clearance_m": scene.config.clearance_m, "part_scale": 1.0}
    drawn = {name: getattr(physics, name) for name in GEOMETRY}
    return {name: value - at[name] for name, value in drawn.items() if value is not None}
