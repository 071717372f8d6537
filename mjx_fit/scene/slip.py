"""Slip of the peg in the hand, under forces and torques beyond what the grip holds.

What a grip holds is bounded by an ellipsoid of forces and torques, and the peg slips along its normal (Goyal,
Ruina and Papadopoulos, Wear 143, 1991), at a speed that grows with the excess. With the mean contact force f
and torque τ of an action, about the sensor's origin between the fingers,

    s = √(|f|² / F² + |τ|² / T²),    v = -w max(s - 1, 0) / s · f / F,    ω = -w max(s - 1, 0) / s · F τ / T²

for F = ``placement.grip_n``, T = ``placement.grip_nm`` and w = ``placement.slip_mps``. The peg moves at the
end of each action.
"""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
from jaxlie import SE3, SO3
from jaxtyping import Float

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.placement import PlacementConfig
from mjx_fit.scene.placement import GRASP
from mjx_fit.types import Array
from mjx_fit.types.physics import Physics
from mjx_fit.utils.rates import ACTION_S


def with_grasp(physics: Physics, config: Config, *shape: int) -> Physics:
    """Return the physics of worlds with grasps of their own, if pegs can slip; else as they are."""
    if not config.placement.slips:
        return physics
    values = {name: getattr(physics, name) for name in GRASP}
    own = {
        name: jnp.broadcast_to(
            jnp.asarray(getattr(config.placement, name) if value is None else value, jnp.float32), shape
        )
        for name, value in values.items()
    }
    return replace(physics, **own)


def slipped(
    physics: Physics,
    wrench_sensor: Float[Array, "50 6"],
    tare_sensor: Float[Array, "6"],
    config: Config,
) -> Physics:
    """Return one world's physics after an action: the peg has slipped if its grip did not hold it.

    Args:
        physics: Physics before, with a grasp.
        wrench_sensor: What the arm exerted on the peg, N and N·m.
        tare_sensor: The same at rest in free space.
        config: Defines the grip, and the length of the peg.
    """
    turn = SO3.from_rpy_radians(*(getattr(physics, name) for name in GRASP[3:]))
    shift = jnp.stack([jnp.asarray(getattr(physics, name)) for name in GRASP[:3]])
    tip = SE3.from_translation(jnp.array([0.0, 0.0, config.scene.peg_length_m]))
    twist = slip_velocity(wrench_sensor.mean(0) - tare_sensor, config.placement)
    moved = tip.inverse() @ SE3.exp(twist * ACTION_S) @ tip
    grasp = moved @ SE3.from_rotation_and_translation(turn, shift)
    angles = grasp.rotation().as_rpy_radians()
    values = [*jnp.moveaxis(grasp.translation(), -1, 0), angles.roll, angles.pitch, angles.yaw]
    return replace(physics, **dict(zip(GRASP, values, strict=True)))


def slip_velocity(wrench: Float[Array, "6"], grip: PlacementConfig) -> Float[Array, "6"]:
    """Return the velocity of a peg relative to the hand that exerts this wrench on it, m/s and rad/s."""
    scale = jnp.array([grip.grip_n] * 3 + [grip.grip_nm] * 3)
    load = wrench / scale
    s = jnp.maximum(jnp.linalg.norm(load), 1e-6)
    speed = grip.slip_mps * jnp.maximum(s - 1, 0) / s
    return -speed * load * grip.grip_n / scale


def carried_on(before: Any, after: Any, active: Any, config: Config) -> Any:
    """Return the physics of worlds whose active ones go on with the grasp that an attempt left them."""
    if not config.placement.slips:
        return before
    n = len(active)
    old = with_grasp(before, config, n)
    own = {name: jnp.where(active, getattr(after, name), getattr(old, name)) for name in GRASP}
    return replace(before, **own)
