"""Admittance in roll and pitch: the tool gives way to torques, until the peg lies flat on what it touches.

A peg that leans against a plate touches it with an edge, and the plate turns it about its lower face's centre
by the torque τ. The tool follows at the rate Y τ, with the admittance Y of ``control.tilt_radps`` at 0.1 N·m.
Flat on the plate, the pressure is within the face and τ is small: the peg feels what an upright one does.
"""

import jax.numpy as jnp
from jaxlie import SO3
from jaxtyping import Float, Key

from mjx_fit.config.schema import Config
from mjx_fit.control.policies import Policy, PolicyInput, PolicyStart, State, hooks_of_inner
from mjx_fit.types import Array
from mjx_fit.utils.pytrees import pytree
from mjx_fit.utils.rates import ACTION_S

GIVEN_NM = 0.1
"""Torque at which the tool gives way at ``control.tilt_radps``, N·m."""
MOST_RAD = 0.12
"""Largest angle by which the tool gives way, rad."""
LEAST_N = 1.5
"""Push below which a torque says little of the tilt, N."""


@pytree
class Levelled:
    """State of a policy whose tool gives way.

    Attributes:
        state: State of the policy.
        given_world: Rotation vector by which the tool has given way; its third component is 0, rad.
    """

    state: State
    given_world: Float[Array, "3"]


def levelled(policy: Policy, config: Config) -> Policy:
    """Return the policy with a tool that gives way; the policy itself if the admittance is 0.

    Args:
        policy: The policy; what it commands adds to what the tool gives.
        config: Defines the admittance, and the distance from the F/T sensor to the TCP.
    """
    admittance = config.control.tilt_radps / GIVEN_NM
    if not admittance:
        return policy

    def init(start: PolicyStart, key: Key[Array, ""]) -> Levelled:
        return Levelled(policy.init(start, key), jnp.zeros(3))

    def act(levelled: Levelled, seen: PolicyInput) -> tuple[Levelled, Float[Array, "6"]]:
        state, command = policy.act(levelled.state, seen)
        given = levelled.given_world + admittance * ACTION_S * _tilting(seen, config)
        given = given * jnp.minimum(1, MOST_RAD / jnp.maximum(jnp.linalg.norm(given), 1e-9))
        turn = jnp.pad(command[3:], (0, 6 - command.shape[0])) + given
        return Levelled(state, given), jnp.concatenate([command[:3], turn])

    return policy._replace(init=init, act=act, turns=True, **hooks_of_inner(policy))


def _tilting(seen: PolicyInput, config: Config) -> Float[Array, "3"]:
    """Return the torque by which a touched plate tilts the peg about the TCP, N·m; 0 without contact."""
    wrench = seen.wrench_sensor.mean(0)
    force, torque = wrench[:3], wrench[3:]
    # The arm holds the peg against it: at rest its torque is the opposite one.
    of_plate = jnp.cross(jnp.array([0.0, 0.0, config.scene.peg_length_m]), force) - torque
    pressed = seen.contact & (force[2] > LEAST_N)
    return (SO3(jnp.asarray(seen.tip_quat_world)) @ of_plate) * jnp.array([1.0, 1.0, 0.0]) * pressed
