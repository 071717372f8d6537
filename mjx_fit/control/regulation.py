"""Outer loop at 10 Hz: make a policy's pushes and paths reach the peg despite an arm that loses force.

Drives with a dead zone or friction swallow a part of every force. The F/T sensor at the wrist shows how much
of the push arrives, and the TCP's position shows how far it lags behind; both losses are estimated and added
to the next command. The second also grows where a peg is held, and then pulls it harder. The lag that the
lateral damping causes, 2 ζ / √kp for each m/s, is known and added at once.
"""

import math
from typing import Any

import jax.numpy as jnp
from jaxtyping import Float, Key

from mjx_fit.config.sections.world import ControlConfig
from mjx_fit.control.force_control import FULL_PUSH_M
from mjx_fit.control.policies import Policy, PolicyInput, PolicyStart, hooks_of_inner
from mjx_fit.types import Array
from mjx_fit.utils.pytrees import pytree
from mjx_fit.utils.rates import ACTION_S

LOSS_GAIN, MOST_LOSS_N = 0.3, 6.0
"""Share of a new difference of forces that enters the estimate of the loss, and the largest loss, N.

An arm does not gain force: a negative estimate is an error of the sensor, and is taken for zero."""
LAG_GAIN, MOST_LAG_M = 0.2, 0.004
"""Share of the lag that enters the lateral correction with each action, and the largest correction, m."""


@pytree
class Losses:
    """Estimated losses, with the state of the policy.

    Attributes:
        state: State of the policy.
        force_n: Part of a push that does not arrive at the peg, downwards, N.
        lag_m: Lateral correction of the command, m.
        wanted_world: Lateral position that the policy asked for with the previous action, m.
        push_m: Vertical command of the previous action, corrected, m.
    """

    state: Any
    force_n: Float[Array, ""]
    lag_m: Float[Array, "2"]
    wanted_world: Float[Array, "2"]
    push_m: Float[Array, ""]


def regulated(policy: Policy, control: ControlConfig) -> Policy:
    """Return a policy whose commands are corrected by the estimated losses, if a push is a force.

    Args:
        policy: The policy.
        control: Defines the meaning of a push, its force and its speed in free space.
    """
    if control.push != "force":
        return policy

    damping_lag = 2 * control.damping_ratio / math.sqrt(control.kp_position) / ACTION_S

    def init(start: PolicyStart, key: Key[Array, ""]) -> Losses:
        zero = jnp.zeros(())
        return Losses(policy.init(start, key), zero, jnp.zeros(2), jnp.zeros(2), zero)

    def act(losses: Losses, seen: PolicyInput) -> tuple[Losses, Float[Array, "k"]]:
        state, command = policy.act(losses.state, seen)
        acted = seen.step > 0
        here = seen.tip_pos_world[:2]
        behind = losses.wanted_world - here
        lag = jnp.clip(losses.lag_m + LAG_GAIN * behind, -MOST_LAG_M, MOST_LAG_M)
        force = losses.force_n + LOSS_GAIN * (_lost(losses.push_m, seen, control) - losses.force_n)
        lag, force = jnp.where(acted, lag, 0), jnp.where(acted, jnp.clip(force, 0, MOST_LOSS_N), 0)
        moves = here + command[:2] - losses.wanted_world
        lateral = command[:2] + lag + jnp.where(acted, damping_lag * moves, 0)
        push = command[2] - force * FULL_PUSH_M / control.press_n
        after = Losses(state, force, lag, here + command[:2], push)
        return after, jnp.concatenate([lateral, push[None], command[3:]])

    return policy._replace(init=init, act=act, **hooks_of_inner(policy))


def _lost(push_m: Float[Array, ""], seen: PolicyInput, control: ControlConfig) -> Float[Array, ""]:
    """Compute the part of the previous action's push that did not arrive at the peg, downwards, N.

    The rest of the commanded force either presses the peg, as the sensor measures, or moves it against the
    damping of the control law.
    """
    damping = control.press_n / control.press_speed_mps
    commanded = -push_m * control.press_n / FULL_PUSH_M + damping * seen.tip_linvel_world[2]
    return commanded - seen.wrench_sensor[:, 2].mean()
