"""The nouns of the library, as pytree dataclasses.

SI units throughout. Quaternions are w x y z. ``*batch`` is any number of leading axes; inside one episode
time comes first: ``J`` actions of ``SUBSTEPS`` simulation steps each. Shape and type indices follow
``scene.shapes``.
"""

from dataclasses import dataclass, field
from typing import Any, TypeVar, dataclass_transform

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int, Key

from mjx_fit.utils.arrays import Array
from mjx_fit.utils.rates import SUBSTEPS

T = TypeVar("T")

ACTION_BYTES = 4 * (SUBSTEPS * 6 + 3 + 4 + 3 + 3 + 3)
"""Size of one action's row of a ``Trace`` in memory."""


def static() -> Any:
    """A field of a ``pytree`` that is no child of it: a Python value, known when JAX traces."""
    return field(metadata={"static": True})


@dataclass_transform(frozen_default=True, field_specifiers=(static,))
def pytree(cls: type[T]) -> type[T]:
    """A frozen dataclass whose fields are the children of a JAX pytree, but for those that are ``static``."""
    return jax.tree_util.register_dataclass(dataclass(frozen=True)(cls))


@pytree
class Attempt:
    """What a world is asked to do: which peg goes to which hole, and where it believes the hole to be.

    Example:
        >>> import jax, mjx_fit as mf
        >>> mf.draw_attempts(jax.random.key(0), 3).estimate_world.shape
        (3, 2)

    Attributes:
        peg_type: Index of the peg's shape.
        hole_type: Index of the hole's shape.
        hole_pos_world: True centre of the hole on the table plane, m.
        estimate_world: Estimate of that centre, over which the attempt starts, m.
        policy: Index into ``mjx_fit.control.policies.NAMES``.
        key: Source of the policy's randomness; it never depends on the batch.
    """

    peg_type: Int[Array, "*batch"]
    hole_type: Int[Array, "*batch"]
    hole_pos_world: Float[Array, "*batch 2"]
    estimate_world: Float[Array, "*batch 2"]
    policy: Int[Array, "*batch"]
    key: Key[Array, "*batch"]


@pytree
class Trace:
    """What the robot measured and did, one row per action.

    Attributes:
        wrench_sensor: Clean force (N) and torque (N·m) that the arm exerts on the peg, in the sensor's frame
            (z along the tool), 500 Hz. The peg's weight and inertia are in it; subtract ``Felt.tare_sensor``.
        tip_pos_world: Centre of the peg's lower face at the end of the action, m.
        tip_quat_world: Its orientation.
        tip_linvel_world: Its linear velocity, m/s.
        tip_angvel_world: Its angular velocity, rad/s.
        action_world: Desired change of the tip's position, as the policy gave it, m.
    """

    wrench_sensor: Float[Array, "*batch J 50 6"]
    tip_pos_world: Float[Array, "*batch J 3"]
    tip_quat_world: Float[Array, "*batch J 4"]
    tip_linvel_world: Float[Array, "*batch J 3"]
    tip_angvel_world: Float[Array, "*batch J 3"]
    action_world: Float[Array, "*batch J 3"]


@pytree
class Felt:
    """What a robot has of one attempt: the sensors, filters and the tracker take this alone.

    Example:
        >>> import jax, mjx_fit as mf
        >>> rollouts = mf.make_engine("native").run(mf.draw_attempts(jax.random.key(0), 2), actions=2)
        >>> rollouts.felt[0].trace.tip_pos_world.shape  # one attempt of the batch
        (2, 3)

    Attributes:
        trace: Rows from ``length`` on are padding: zeros.
        length: Number of actions that were performed.
        tare_sensor: Reading of the wrist at rest in free space just before the attempt, N and N·m; clean in
            simulation.
        estimate_world: Where the attempt started: the estimate μ0 of the hole's centre, m.
        peg_type: Index of the shape of the peg in hand.
    """

    trace: Trace
    length: Int[Array, "*batch"]
    tare_sensor: Float[Array, "*batch 6"]
    estimate_world: Float[Array, "*batch 2"]
    peg_type: Int[Array, "*batch"]

    def __getitem__(self, rows: Any) -> "Felt":
        """One attempt of a batch, or several."""
        return jax.tree.map(lambda leaf: leaf[rows], self)


@pytree
class Truth:
    """What only a simulator knows of one attempt.

    Attributes:
        hole_type: Index of the hole's shape.
        hole_pos_world: True centre of the hole on the table plane, m.
        inserted: Whether the tip ended in the hole, ``task.insertion_depth_m`` below the plate's top or more.
        valid: False where the simulation diverged, or the attempt left what is believed (a peg that tilts too
            far or leaves its plate, a torque limit for too long: ``mjx_fit.engines.plausible``), in the last
            action counted by ``Felt.length``.
        end_qpos: Joint angles at the end, rad; where not valid, before the action that made it so.
        end_qvel: Joint velocities at the same moment, rad/s.
    """

    hole_type: Int[Array, "*batch"]
    hole_pos_world: Float[Array, "*batch 2"]
    inserted: Bool[Array, "*batch"]
    valid: Bool[Array, "*batch"]
    end_qpos: Float[Array, "*batch joints"]
    end_qvel: Float[Array, "*batch joints"]

    @property
    def failed(self) -> Bool[Array, "*batch"]:
        """Whether the attempt was simulated without fault and the peg is not in: these teach something."""
        return self.valid & ~self.inserted


@pytree
class Rollout:
    """One simulated attempt: what was felt, and the truth.

    Example:
        >>> import jax, mjx_fit as mf
        >>> rollouts = mf.make_engine("native").run(mf.draw_attempts(jax.random.key(0), 2), actions=2)
        >>> rollouts.truth.inserted.tolist()
        [False, False]
    """

    felt: Felt
    truth: Truth

    def __getitem__(self, rows: Any) -> "Rollout":
        """One attempt of a batch, or several."""
        return jax.tree.map(lambda leaf: leaf[rows], self)

    @property
    def succeeded(self) -> Bool[Array, "*batch"]:
        """Whether the peg is in a hole of its own type."""
        return self.truth.inserted & (self.felt.peg_type == self.truth.hole_type)

    @property
    def inserted_wrongly(self) -> Bool[Array, "*batch"]:
        """Whether the peg is in a hole of another type: no success, and nothing that the robot notices."""
        return self.truth.inserted & (self.felt.peg_type != self.truth.hole_type)


@pytree
class Reading:
    """A trace as the sensors are shown it: tared, noisy, relative to the estimate, a fixed number of rows.

    Nothing in it depends on the true position or type of the hole except through what was felt.

    Attributes:
        wrench_sensor: Tared and noisy wrench, N and N·m.
        pressure_tip: Centre of pressure on the peg's lower face over the action, from its centre, world x and
            y, m: follows from the wrench.
        tip_pos_estimate: Tip position relative to the estimate (x, y) and to the plate's top (z), m.
        tip_quat_world: Orientation of the tip.
        tip_linvel_world: m/s.
        tip_angvel_world: rad/s.
        contact: Contact bit, as a float 0 or 1, from the measured force (``sensors.preprocess.in_contact``).
        action_world: m.
        mask: True where the row is real, False where it is padding.
        peg_type: Index of the peg's shape, which the robot knows.
    """

    wrench_sensor: Float[Array, "*batch L 50 6"]
    pressure_tip: Float[Array, "*batch L 2"]
    tip_pos_estimate: Float[Array, "*batch L 3"]
    tip_quat_world: Float[Array, "*batch L 4"]
    tip_linvel_world: Float[Array, "*batch L 3"]
    tip_angvel_world: Float[Array, "*batch L 3"]
    contact: Float[Array, "*batch L"]
    action_world: Float[Array, "*batch L 3"]
    mask: Bool[Array, "*batch L"]
    peg_type: Int[Array, "*batch"]


@pytree
class Belief:
    """What is believed about one hole.

    Example:
        >>> import numpy as np, mjx_fit as mf
        >>> belief = mf.Belief(np.zeros(2), 1e-4 * np.eye(2), np.log([0.5, 0.25, 0.25]))
        >>> belief.type_probability.tolist()
        [0.5, 0.25, 0.25]

    Attributes:
        pos_mean_world: Mean μ of the hole's position, m.
        pos_cov: Covariance Σ of the hole's position, m².
        type_logp: Log probability ξ of each shape; its exponentials add up to one.
    """

    pos_mean_world: Float[Array, "*batch 2"]
    pos_cov: Float[Array, "*batch 2 2"]
    type_logp: Float[Array, "*batch C"]

    @property
    def type_probability(self) -> Float[Array, "*batch C"]:
        """ξ: the probability of each shape."""
        return jnp.exp(self.type_logp)


@pytree
class Observation:
    """What the virtual sensors make of a reading, in the form in which the filters take it.

    Attributes:
        innovation: h_pos: estimate of the true position minus the estimate that the attempt started from, m.
        pos_noise_cov: R: covariance of the innovation's error, m².
        match_logits: h_match: logits of (mismatch, match).
        match_model_logp: log H(o_match | c, c_peg) for the peg in hand: rows are hole types, columns o_match.
    """

    innovation: Float[Array, "*batch 2"]
    pos_noise_cov: Float[Array, "*batch 2 2"]
    match_logits: Float[Array, "*batch 2"]
    match_model_logp: Float[Array, "*batch C 2"]
