"""Low-level policies: pure functions that give the desired change of the tip, action by action.

A policy is a pair of functions, ``Policy(init, act)``, written in JAX: both engines compile it into their
rollouts. It carries a state of its own from action to action, and sees what a robot can measure. The
randomness of step j comes from ``fold_in(key, j)``, so it depends on the attempt alone.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int, Key

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.world import RandomConfig, SpiralConfig
from mjx_fit.types import Array, Attempt, pytree, static

NAMES = ("spiral", "random")
SPIRAL, RANDOM = range(len(NAMES))
OWN = len(NAMES)
"""Index of an engine's own policy, which is none of ``NAMES``."""

State = Any
"""Whatever a policy carries from action to action: a pytree of arrays, the same in shape and type always."""


@pytree
class PolicyStart:
    """What a policy knows before its first action.

    Attributes:
        peg_type: Index of the peg's shape.
        estimate_world: Estimate p of the hole's centre, over which the attempt starts, m.
        policy: The attempt's index into ``NAMES``, for a policy that chooses by it.
    """

    peg_type: Int[Array, ""]
    estimate_world: Float[Array, "2"]
    policy: Int[Array, ""]


@pytree
class PolicyInput:
    """What a policy sees before each action: measurements, the clock, and what it knew from the start.

    Example:
        >>> import jax.numpy as jnp, mjx_fit as mf
        >>> def towards_estimate(seen: mf.PolicyInput):
        ...     return jnp.append(seen.start.estimate_world - seen.tip_pos_world[:2], -0.004)
        >>> policy = mf.stateless_policy(towards_estimate)

    Attributes:
        start: As ``Policy.init`` was given it.
        attempt_key: The attempt's key, likewise.
        key: Source of this action's randomness: ``fold_in(attempt_key, step)``.
        step: Number j of the action, from 0: time is j / 10 s.
        horizon: Number J of actions to plan for; a Python int, known when the policy is compiled.
        tip_pos_world: Where the tip is, x, m.
        tip_quat_world: Its orientation, w x y z.
        tip_linvel_world: Its linear velocity, m/s.
        tip_angvel_world: Its angular velocity, rad/s.
        wrench_sensor: What the wrist measured during the action before, 500 Hz, tared, with the sensor's
            noise: force (N) and torque (N·m) that the arm exerts on the peg. Noise alone before the first.
        contact: Whether it says that the peg touched something (``mjx_fit.sensors.preprocess.in_contact``).
    """

    start: PolicyStart
    attempt_key: Key[Array, ""]
    key: Key[Array, ""]
    step: Int[Array, ""]
    tip_pos_world: Float[Array, "3"]
    tip_quat_world: Float[Array, "4"]
    tip_linvel_world: Float[Array, "3"]
    tip_angvel_world: Float[Array, "3"]
    wrench_sensor: Float[Array, "50 6"]
    contact: Bool[Array, ""]
    horizon: int = static()


class Policy(NamedTuple):
    """A low-level policy, of one attempt in one world.

    Example:
        Press down until the wrist says contact, then stay:

        >>> import jax, jax.numpy as jnp, mjx_fit as mf
        >>> def act(touched, seen):
        ...     touched = touched | seen.contact
        ...     return touched, jnp.array([0.0, 0.0, -0.004]) * ~touched
        >>> probe = mf.Policy(init=lambda start, key: jnp.array(False), act=act)
        >>> engine = mf.make_engine("native", policy=probe)
        >>> rollouts = engine.run(mf.draw_attempts(jax.random.key(0), 2), actions=4)
        >>> (rollouts.felt.trace.action_world[:, :, 2] < 0).tolist()
        [[True, False, False, False], [True, False, False, False]]

    Attributes:
        init: From the start and the attempt's key, the state before the first action.
        act: From the state and what is seen, the state after the action, and the command: the desired change
            of the tip's position in the world frame (3,), m.
        name: What data sets and results call it; they refuse a policy without one.
    """

    init: Callable[[PolicyStart, Key[Array, ""]], State]
    act: Callable[[State, PolicyInput], tuple[State, Float[Array, "3"]]]
    name: str = ""


def start_of(attempt: Attempt) -> PolicyStart:
    """The part of an attempt that a policy may know: nothing of the true hole."""
    return PolicyStart(attempt.peg_type, attempt.estimate_world, attempt.policy)


def shipped(config: Config) -> Policy:
    """The policy that an attempt names: ``NAMES[attempt.policy]``."""
    return by_name(spiral(config.spiral), random(config.random))


def by_name(*members: Policy) -> Policy:
    """A policy that acts as the member with the index ``PolicyStart.policy``."""

    def init(start: PolicyStart, key: Key[Array, ""]) -> State:
        return tuple(member.init(start, key) for member in members)

    def act(state: State, seen: PolicyInput) -> tuple[State, Float[Array, "3"]]:
        acted = [member.act(own, seen) for member, own in zip(members, state, strict=True)]
        command = acted[-1][1]
        for i in reversed(range(len(members) - 1)):
            command = jnp.where(seen.start.policy == i, acted[i][1], command)
        return tuple(own for own, _ in acted), command

    return Policy(init, act)


def stateless(command: Callable[[PolicyInput], Float[Array, "3"]], name: str = "") -> Policy:
    """A policy without a state: its command follows from what it sees.

    Example:
        >>> import jax.numpy as jnp, mjx_fit as mf
        >>> press = mf.stateless_policy(lambda seen: jnp.array([0.0, 0.0, -0.004]))
        >>> engine = mf.make_engine("native", policy=press)
    """
    return Policy(lambda start, key: (), lambda state, seen: ((), command(seen)), name)


def spiral(config: SpiralConfig) -> Policy:
    """Algorithm 4 of the paper, around the estimate; see ``spiral_command``."""

    def command(seen: PolicyInput) -> Float[Array, "3"]:
        return spiral_command(seen.step, seen.horizon, _relative(seen), seen.key, config)

    return stateless(command)


def random(config: RandomConfig) -> Policy:
    """Sweeps around the estimate; see ``random_command``."""

    def command(seen: PolicyInput) -> Float[Array, "3"]:
        return random_command(seen.step, _relative(seen), seen.key, seen.attempt_key, config)

    return stateless(command)


def _relative(seen: PolicyInput) -> Float[Array, "2"]:
    """Where the tip is from the estimate, m."""
    return seen.tip_pos_world[:2] - seen.start.estimate_world


def spiral_command(
    step: Int[Array, ""],
    horizon: int,
    tip_pos_estimate: Float[Array, "2"],
    key: Key[Array, ""],
    config: SpiralConfig,
) -> Float[Array, "3"]:
    """Algorithm 4 of the paper: u = u_spiral + u_wiggle + p - x.

    p is two-dimensional, so the vertical part is -δz + |wiggle_z| from where the peg is: a constant push.

    Args:
        step: j.
        horizon: J.
        tip_pos_estimate: x - p, m.
        key: Source of this step's wiggle.
        config: r_max, n_rot, δz and σ.
    """
    progress = step / horizon
    angle = 2 * jnp.pi * config.turns * progress
    radius = config.radius_m * progress
    ring = radius * jnp.array([jnp.cos(angle), jnp.sin(angle)])
    return _pressed(ring - tip_pos_estimate, config.push_m) + _wiggle(key, config.wiggle_m)


def random_command(
    step: Int[Array, ""],
    tip_pos_estimate: Float[Array, "2"],
    key: Key[Array, ""],
    attempt_key: Key[Array, ""],
    config: RandomConfig,
) -> Float[Array, "3"]:
    """Straight sweeps between random way-points around the estimate, pressed on the plate, with wiggle.

    The paper gives its random policy one line. A pure random walk with steps of its σ hardly moves against
    friction; sweeps cross the hole's edges from all sides and stay in contact.

    Args:
        step: j.
        tip_pos_estimate: x - p, m.
        key: Source of this step's wiggle.
        attempt_key: Source of the way-points.
        config: Reach, pace, push and wiggle.
    """
    sweep, phase = jnp.divmod(step, config.actions_per_sweep)

    def way_point(number):
        # Offset by 2^20 to keep clear of the steps' keys; the first sweep starts over the estimate.
        draw = jax.random.uniform(jax.random.fold_in(attempt_key, 2**20 + number), (2,), minval=-1.0)
        return jnp.where(number == 0, 0.0, config.reach_m * draw)

    fraction = (phase + 1) / config.actions_per_sweep
    goal = (1 - fraction) * way_point(sweep) + fraction * way_point(sweep + 1)
    return _pressed(goal - tip_pos_estimate, config.push_m) + _wiggle(key, config.wiggle_m)


def _pressed(planar: Float[Array, "2"], push_m: float) -> Float[Array, "3"]:
    return jnp.concatenate([planar, jnp.array([-push_m])])


def _wiggle(key: Key[Array, ""], sigma_m: float) -> Float[Array, "3"]:
    noise = sigma_m * jax.random.normal(key, (3,))
    return noise.at[2].set(jnp.abs(noise[2]))
