"""Low-level policies: pure functions of (step, observation, key) that give the desired change of the tip.

The randomness of step j comes from ``fold_in(key, j)``, so it depends on the attempt alone.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int, Key

from mjx_fit.config import Config
from mjx_fit.settings import RandomConfig, SpiralConfig
from mjx_fit.types import Array, Attempt

Policy = Callable[[Attempt, Int[Array, ""], int, Float[Array, "3"], Config], Float[Array, "3"]]
"""What an engine asks for each action: see ``action``."""

POLICIES = ("spiral", "random")
SPIRAL, RANDOM = range(len(POLICIES))


def action(
    attempt: Attempt, step: Int[Array, ""], horizon: int, tip_pos_world: Float[Array, "3"], config: Config
) -> Float[Array, "3"]:
    """The action of the policy that an attempt names.

    Args:
        attempt: One attempt; its estimate is p, its key the source of the wiggle.
        step: Number j of the action, from 0.
        horizon: Number J of actions in the attempt.
        tip_pos_world: Where the tip is, x, m.
        config: Parameters of the policies.

    Returns:
        Desired change of the tip's position in the world frame, m.
    """
    key = jax.random.fold_in(attempt.key, step)
    relative = tip_pos_world[:2] - attempt.estimate_world
    searching = spiral(step, horizon, relative, key, config.spiral)
    exploring = random(step, relative, key, attempt.key, config.random)
    return jnp.where(attempt.policy == SPIRAL, searching, exploring)


def spiral(
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


def random(
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
