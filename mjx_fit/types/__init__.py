"""Core data types of the library, as pytree dataclasses.

All quantities are in SI units; quaternions are in w x y z order. ``*batch`` stands for any number of leading
axes. Time is the first axis within an episode: ``J`` actions of 50 simulation steps each. Type indices follow
``scene.shapes``.
"""

from typing import Any

import jax
from jaxtyping import Bool, Float, Int, Key

from mjx_fit.types.belief import Belief as Belief
from mjx_fit.types.belief import Memory as Memory
from mjx_fit.types.contact import Particles as Particles
from mjx_fit.types.contact import Rows as Rows
from mjx_fit.types.physics import AS_CONFIGURED, Physics
from mjx_fit.types.readings import Observation as Observation
from mjx_fit.types.readings import Reading as Reading
from mjx_fit.utils.arrays import Array
from mjx_fit.utils.pytrees import pytree


@pytree
class Attempt:
    """Specification of an insertion attempt: the peg, the hole, and the estimated hole position.

    Example:
        >>> import jax, mjx_fit as mf
        >>> mf.draw_attempts(jax.random.key(0), 3).estimate_world.shape
        (3, 2)

    Attributes:
        peg_type: Index of the peg's shape.
        hole_type: Index of the hole's shape.
        hole_pos_world: True centre of the hole on the table plane, m.
        estimate_world: Estimate of the place for the tool, above which the attempt starts: x and y of the
            centre, then any other coordinates that are believed (``filter.coordinates``), m and rad.
        policy: Index into ``mjx_fit.control.policies.NAMES``.
        key: Random key of the policy, independent of the batch.
        physics: Quantities that this world has of its own.
        belief: Belief about the hole before the attempt, for policies that update it; None: the detector's
            prior about ``estimate_world``.
        elsewhere_per_s: Insertions per second that the best other hole promises, for policies that leave a
            hole; None: there is no other.
    """

    peg_type: Int[Array, "*batch"]
    hole_type: Int[Array, "*batch"]
    hole_pos_world: Float[Array, "*batch 2"]
    estimate_world: Float[Array, "*batch D"]
    policy: Int[Array, "*batch"]
    key: Key[Array, "*batch"]
    physics: Physics = AS_CONFIGURED
    belief: Belief | None = None
    elsewhere_per_s: Float[Array, "*batch"] | None = None


@pytree
class Trace:
    """Trajectory of one attempt: measurements and commands, one row per action.

    Attributes:
        wrench_sensor: Noise-free force (N) and torque (N·m) that the arm exerts on the peg, in the sensor
            frame (z along the tool), at 500 Hz. It includes the peg's weight and inertia; subtract
            ``Felt.tare_sensor``.
        tip_pos_world: Position of the tool centre point (TCP), the centre of the peg's lower face, at the end
            of the action, m.
        tip_quat_world: Orientation of the TCP.
        tip_linvel_world: Linear velocity of the TCP, m/s.
        tip_angvel_world: Angular velocity of the TCP, rad/s.
        action_world: Commanded displacement of the TCP, as output by the policy, m.
        turn_world: Commanded orientation, the rotation vector from straight down about the world's axes, rad;
            None: the policy commands displacements alone, straight down.
    """

    wrench_sensor: Float[Array, "*batch J 50 6"]
    tip_pos_world: Float[Array, "*batch J 3"]
    tip_quat_world: Float[Array, "*batch J 4"]
    tip_linvel_world: Float[Array, "*batch J 3"]
    tip_angvel_world: Float[Array, "*batch J 3"]
    action_world: Float[Array, "*batch J 3"]
    turn_world: Float[Array, "*batch J 3"] | None = None


@pytree
class StartPose:
    """Measured pose of the TCP at rest in free space, before an attempt.

    Attributes:
        pos_world: Position, m.
        quat_world: Orientation, quaternion w x y z.
    """

    pos_world: Float[Array, "*batch 3"]
    quat_world: Float[Array, "*batch 4"]


@pytree
class Felt:
    """Measurements of one attempt that a robot has access to; the only input of sensors, filters and tracker.

    Example:
        >>> import jax, mjx_fit as mf
        >>> rollouts = mf.make_engine("native").run(mf.draw_attempts(jax.random.key(0), 2), actions=2)
        >>> rollouts.felt[0].trace.tip_pos_world.shape  # one attempt of the batch
        (2, 3)

    Attributes:
        trace: Trajectory; rows from index ``length`` on are zero padding.
        length: Number of actions performed.
        tare_sensor: F/T sensor reading at rest in free space just before the attempt, N and N·m; noise-free
            in simulation.
        estimate_world: Estimate μ0, above which the attempt started, as in ``Attempt``, m and rad.
        peg_type: Index of the shape of the peg in hand.
        start: Pose before the attempt; None: that of simulated attempts (``sensors.pose.start_of``).
    """

    trace: Trace
    length: Int[Array, "*batch"]
    tare_sensor: Float[Array, "*batch 6"]
    estimate_world: Float[Array, "*batch D"]
    peg_type: Int[Array, "*batch"]
    start: StartPose | None = None

    def __getitem__(self, rows: Any) -> "Felt":
        """Select one or several attempts of a batch."""
        return jax.tree.map(lambda leaf: leaf[rows], self)


@pytree
class Truth:
    """Ground truth of one attempt, known only to a simulator.

    Attributes:
        hole_type: Index of the hole's shape.
        hole_pos_world: True centre of the hole on the table plane, m.
        inserted: True if the TCP ended in the hole, at least ``task.insertion_depth_m`` below the top of the
            socket.
        valid: False if the simulation diverged or became implausible (the peg tilted too far or left its
            socket, or a joint stayed at its torque limit for too long: ``mjx_fit.engines.plausible``) in the
            last action counted by ``Felt.length``.
        end_qpos: Final joint angles, rad; for invalid attempts, those before the invalid action.
        end_qvel: Joint velocities at the same time, rad/s.
        physics: Quantities that the world had of its own; the grasp is that at the end of the attempt.
    """

    hole_type: Int[Array, "*batch"]
    hole_pos_world: Float[Array, "*batch 2"]
    inserted: Bool[Array, "*batch"]
    valid: Bool[Array, "*batch"]
    end_qpos: Float[Array, "*batch joints"]
    end_qvel: Float[Array, "*batch joints"]
    physics: Physics = AS_CONFIGURED

    @property
    def failed(self) -> Bool[Array, "*batch"]:
        """True for valid attempts that did not insert the peg; only these update the belief."""
        return self.valid & ~self.inserted


@pytree
class Rollout:
    """One simulated attempt: measurements and ground truth, and what the policy reported.

    Attributes:
        felt: Measurements.
        truth: Ground truth.
        report: ``Policy.report`` after each action, (J, ...) for each leaf; None without one.
        sensed: Whether the robot measured an insertion, which ended the attempt (``task.success: sensed``);
            None: the truth told it.

    Example:
        >>> import jax, mjx_fit as mf
        >>> rollouts = mf.make_engine("native").run(mf.draw_attempts(jax.random.key(0), 2), actions=2)
        >>> rollouts.truth.inserted.tolist()
        [False, False]
    """

    felt: Felt
    truth: Truth
    report: Any = None
    sensed: Bool[Array, "*batch"] | None = None

    def __getitem__(self, rows: Any) -> "Rollout":
        """Select one or several attempts of a batch."""
        return jax.tree.map(lambda leaf: leaf[rows], self)

    @property
    def taken(self) -> Bool[Array, "*batch"]:
        """True if the robot takes the peg for inserted: it measured so, or the truth tells it."""
        return self.truth.inserted if self.sensed is None else self.sensed

    @property
    def succeeded(self) -> Bool[Array, "*batch"]:
        """True if the peg was inserted into a hole of its own type."""
        return self.truth.inserted & (self.felt.peg_type == self.truth.hole_type)

    @property
    def inserted_wrongly(self) -> Bool[Array, "*batch"]:
        """True if the peg was inserted into a hole of another type, a failure the robot cannot detect."""
        return self.truth.inserted & (self.felt.peg_type != self.truth.hole_type)
