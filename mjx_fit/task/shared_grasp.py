"""What the holes of an assembly share through the peg in hand: its grasp (``mjx_fit.filters.joint``).

Contact tells where a hole is relative to the peg. With ``filter.grasp_std_m`` or ``filter.grasp_std_rad``
above 0, a joint Gaussian over the grasp and all holes of a row is kept beside the beliefs: what is felt at
one hole corrects the others, until the peg changes.
"""

from dataclasses import fields, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from mjx_fit.config.schema import Config
from mjx_fit.filters import chart, joint
from mjx_fit.filters.updates import detected_belief
from mjx_fit.scene.placement import GRASP, place_for_tool
from mjx_fit.types import Array, Belief
from mjx_fit.types.physics import Physics
from mjx_fit.utils.errors import RequestError


def in_hand(physics: Physics, peg: Int[np.ndarray, "*b"], hole: Int[np.ndarray, "*b"]) -> Physics:
    """Return the physics (R, ...) of pegs at holes: the grasp is that of the peg, all else that of the hole.

    Args:
        physics: Physics of the world of each hole, and of the grasp of each peg, (R, n).
        peg: Index of the peg, (R, ...).
        hole: Index of the hole, likewise.
    """
    rows = np.arange(len(peg)).reshape(-1, *[1] * (peg.ndim - 1))
    values = {field.name: getattr(physics, field.name) for field in fields(Physics)}
    return Physics(
        **{
            name: None if leaf is None else leaf[rows, peg if name in GRASP else hole]
            for name, leaf in values.items()
        }
    )


def regrasped(
    physics: Physics, peg: Int[np.ndarray, "R"], left: Physics, active: Bool[np.ndarray, "R"]
) -> Physics:
    """Return the physics (R, n) after attempts that left the pegs in hand as ``left`` (R,) has them."""
    values, rows = {name: np.array(getattr(physics, name)) for name in GRASP}, np.flatnonzero(active)
    for name, own in values.items():
        own[rows, peg[rows]] = np.asarray(getattr(left, name))[rows]
    return replace(physics, **values)


def places_for_tool(
    hole_pos_world: Float[np.ndarray, "R n 2"], physics: Physics, config: Config
) -> Float[np.ndarray, "R n n D"]:
    """Return where the tool has to be for each peg (second axis) to be in each hole (third), m and rad."""
    n_rows, n, _ = hole_pos_world.shape
    peg, hole = (np.broadcast_to(one, (n_rows, n, n)) for one in np.indices((n, n)))
    each = np.broadcast_to(hole_pos_world[:, None], (n_rows, n, n, 2))
    return np.asarray(place_for_tool(each, in_hand(physics, peg, hole), config))


class SharedGrasp:
    """Joint Gaussians of R rows, modified in place.

    They are in double precision: a hole that is known to 0.1 mm and a grasp that is not are in one matrix.

    Args:
        estimate_world: Detections of the holes of each row, (R, n, 2), m.
        config: Defines the coordinates and the spread of grasps.

    Raises:
        RequestError: Grasps vary by as much as what is believed about a hole, which includes them.
    """

    def __init__(self, estimate_world: Float[np.ndarray, "R n 2"], config: Config):
        detected = detected_belief(jnp.asarray(estimate_world), config)
        self._names = config.filter.coordinates
        stds = [
            config.filter.grasp_std_rad if name in chart.AXIS else config.filter.grasp_std_m
            for name in self._names
        ]
        self._grasp = np.diag(np.square(stds))
        cov = np.asarray(detected.cov, float) - self._grasp
        if (np.diagonal(cov, axis1=-2, axis2=-1) <= 0).any():
            raise RequestError(
                f"config: filter.grasp_std_m, grasp_std_rad: {config.filter.grasp_std_m:g} and "
                f"{config.filter.grasp_std_rad:g} are invalid: expected less than those of detector, which "
                "include them"
            )
        with jax.enable_x64(True):
            made = joint.independent(np.asarray(detected.mean_world, float), cov, self._grasp)
            self._joint, self._detected = (jax.tree.map(np.array, made) for _ in range(2))
        self._learn = jax.jit(partial(joint.learnt_at, coordinates=self._names))
        self._relative = jax.jit(jax.vmap(self._all_holes))

    def learn(self, rows: Int[np.ndarray, "k"], hole: Int[np.ndarray, "R"], after: Belief) -> None:
        """Carry the new beliefs of some rows about one hole each, (R,), to their grasps and other holes."""
        # All rows, of which some are kept: one compilation serves any number of them.
        mean, cov = (np.asarray(leaf, float) for leaf in (after.mean_world, after.cov))
        with jax.enable_x64(True):
            new = self._learn(self._joint, hole, mean, cov)
        self._put(rows, jax.tree.map(lambda leaf: np.asarray(leaf)[rows], new))

    def new_peg(self, rows: Int[np.ndarray, "k"]) -> None:
        """Forget the grasps of these rows, whose pegs are new."""
        own = jax.tree.map(lambda leaf: leaf[rows], self._joint)
        with jax.enable_x64(True):
            self._put(rows, joint.with_new_peg(own, self._grasp))

    def beliefs(self, beliefs: Belief, which: Bool[np.ndarray, "R"]) -> Belief:
        """Return the beliefs of some rows about all holes relative to the peg in hand; types stay."""
        return self._as_beliefs(self._joint, beliefs, which)

    def detections(self, beliefs: Belief, which: Bool[np.ndarray, "R"]) -> Belief:
        """Return the same of holes as they were detected, with the grasp as it is known by now."""
        mean, cov = self._detected.mean_world.copy(), self._detected.cov.copy()
        mean[:, 0], cov[:, 0, :, 0] = self._joint.mean_world[:, 0], self._joint.cov[:, 0, :, 0]
        return self._as_beliefs(joint.Joint(mean, cov), beliefs, which)

    def _as_beliefs(self, known: joint.Joint, beliefs: Belief, which: Bool[np.ndarray, "R"]) -> Belief:
        with jax.enable_x64(True):
            mean, cov = (np.asarray(leaf, np.float32) for leaf in self._relative(known))
        return replace(
            beliefs,
            mean_world=np.where(which[:, None, None], mean, beliefs.mean_world),
            cov=np.where(which[:, None, None, None], cov, beliefs.cov),
        )

    def _all_holes(self, one: joint.Joint) -> tuple[Array, Array]:
        holes = jnp.arange(one.mean_world.shape[0] - 1)
        return jax.vmap(lambda hole: joint.relative_to_peg(one, hole, self._names))(holes)

    def _put(self, rows: Int[np.ndarray, "k"], new: joint.Joint) -> None:
        for leaf, value in zip(jax.tree.leaves(self._joint), jax.tree.leaves(new), strict=True):
            leaf[rows] = np.asarray(value)
