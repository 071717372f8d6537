"""Policies that act on time and place alone: the paper's spirals, and random sweeps for data."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int, Key

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.world import RandomConfig, SpiralConfig
from mjx_fit.control.policies import Policy, PolicyInput, by_name, stateless
from mjx_fit.types import Array
from mjx_fit.utils.rates import ACTION_S

YAW_S, TILT_S = 3.1, 1.7
"""Periods of a spiral's search in yaw and tilt, s."""


def shipped(config: Config) -> Policy:
    """Return the policy that follows each attempt's choice, ``NAMES[attempt.policy]``."""
    return by_name(spiral(config.spiral), random(config.random))


def spiral(config: SpiralConfig) -> Policy:
    """Create the spiral search around the estimate, Algorithm 4 of the paper; see ``spiral_command``."""
    turns = config.yaw_rad > 0 or config.tilt_rad > 0

    def command(seen: PolicyInput) -> Float[Array, "k"]:
        moves = spiral_command(seen.step, seen.horizon, _relative(seen), seen.key, config)
        return jnp.concatenate([moves, spiral_turn(seen.step, config)]) if turns else moves

    return stateless(command, turns=turns)


def random(config: RandomConfig) -> Policy:
    """Create the policy of random sweeps around the estimate; see ``random_command``."""
    turns = config.yaw_rad > 0 or config.tilt_rad > 0

    def command(seen: PolicyInput) -> Float[Array, "k"]:
        moves = random_command(seen.step, _relative(seen), seen.key, seen.attempt_key, config)
        turn = random_turn(seen.step, seen.attempt_key, config)
        return jnp.concatenate([moves, turn]) if turns else moves

    return stateless(command, turns=turns)


def _relative(seen: PolicyInput) -> Float[Array, "2"]:
    """Return the TCP position relative to the estimate, m."""
    return seen.tip_pos_world[:2] - seen.start.estimate_world


def spiral_command(
    step: Int[Array, ""],
    horizon: int,
    tip_pos_estimate: Float[Array, "2"],
    key: Key[Array, ""],
    config: SpiralConfig,
) -> Float[Array, "3"]:
    """Compute the spiral command, Algorithm 4 of the paper: u = u_spiral + u_wiggle + p - x.

    The estimate p is two-dimensional, so the vertical component is -δz + |wiggle_z| relative to the peg: a
    constant push.

    Args:
        step: Index j of the action.
        horizon: Number J of actions.
        tip_pos_estimate: TCP position relative to the estimate, x - p, m.
        key: Random key of this action's exploration noise.
        config: Parameters r_max, n_rot, δz and σ.
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
    """Compute the command of straight sweeps between random way-points, pressed on the socket, with noise.

    The paper describes its random policy in one line. A pure random walk with steps of its σ hardly moves
    against friction; sweeps cross the hole's edges from all sides and stay in contact.

    Args:
        step: Index j of the action.
        tip_pos_estimate: TCP position relative to the estimate, x - p, m.
        key: Random key of this action's exploration noise.
        attempt_key: Random key of the way-points.
        config: Reach, actions per sweep, push and exploration noise.
    """

    def way_point(number):
        return config.reach_m * _at_way_point(number, attempt_key, 2**20, 2)

    goal = _swept(way_point, step, config)
    return _pressed(goal - tip_pos_estimate, config.push_m) + _wiggle(key, config.wiggle_m)


def spiral_turn(step: Int[Array, ""], config: SpiralConfig) -> Float[Array, "3"]:
    """Compute the orientation of a spiral's search in yaw and tilt, a rotation vector, rad.

    The periods have no common multiple within an attempt, so that yaw and tilt meet in all combinations.
    """
    yaw, tilt = (2 * jnp.pi * ACTION_S * step / period for period in (YAW_S, TILT_S))
    leans = config.tilt_rad * jnp.minimum(1, ACTION_S * step / TILT_S)
    return jnp.array([leans * jnp.cos(tilt), leans * jnp.sin(tilt), config.yaw_rad * jnp.sin(yaw)])


def random_turn(step: Int[Array, ""], attempt_key: Key[Array, ""], config: RandomConfig) -> Float[Array, "3"]:
    """Compute the orientation on the way between those of random way-points, a rotation vector, rad."""
    most = jnp.array([config.tilt_rad, config.tilt_rad, config.yaw_rad])
    return _swept(lambda number: most * _at_way_point(number, attempt_key, 2**20 + 2**19, 3), step, config)


def _swept(
    way_point: Callable[[Int[Array, ""]], Float[Array, "k"]], step: Int[Array, ""], config: RandomConfig
) -> Float[Array, "k"]:
    """Return the point of this action on the way from one way-point to the next."""
    sweep, phase = jnp.divmod(step, config.actions_per_sweep)
    fraction = (phase + 1) / config.actions_per_sweep
    return (1 - fraction) * way_point(sweep) + fraction * way_point(sweep + 1)


def _at_way_point(
    number: Int[Array, ""], attempt_key: Key[Array, ""], offset: int, k: int
) -> Float[Array, "k"]:
    """Draw a way-point, uniform in [-1, 1]; the first is 0: above the estimate, straight down.

    The offset separates the key from those of the actions.
    """
    draw = jax.random.uniform(jax.random.fold_in(attempt_key, offset + number), (k,), minval=-1.0)
    return jnp.where(number == 0, 0.0, draw)


def _pressed(planar: Float[Array, "2"], push_m: float) -> Float[Array, "3"]:
    return jnp.concatenate([planar, jnp.array([-push_m])])


def _wiggle(key: Key[Array, ""], sigma_m: float) -> Float[Array, "3"]:
    noise = sigma_m * jax.random.normal(key, (3,))
    return noise.at[2].set(jnp.abs(noise[2]))
