"""Physical quantities of one world, where they differ from the configuration."""

from dataclasses import fields
from typing import Any

from jaxtyping import Float

from mjx_fit.utils.arrays import Array
from mjx_fit.utils.pytrees import pytree

Drawn = Float[Array, "*batch"] | None


@pytree
class Physics:
    """Values drawn for one world; None: the value of the configuration, which costs no computation.

    Attributes:
        friction: ``scene.friction``.
        contact_time_s: ``scene.contact_time_s``.
        contact_damping: ``scene.contact_damping``.
        clearance_m: ``scene.clearance_m``.
        part_scale: Factor of all cross-sections, of pegs and holes alike.
        kp_position: ``control.kp_position``.
        kp_orientation: ``control.kp_orientation``.
        damping_ratio: ``control.damping_ratio``.
        smoothing_s: ``control.smoothing_s``.
        goal_delay_s: ``control.goal_delay_s``.
        dead_zone_n: ``arm.dead_zone_n``.
        dead_zone_nm: ``arm.dead_zone_nm``.
        joint_friction_nm: ``arm.joint_friction_nm``.
        joint_damping_nms: ``arm.joint_damping_nms``.
        payload_kg: ``arm.payload_kg``.
        tilt_x_rad: ``arm.tilt_x_rad``.
        tilt_y_rad: ``arm.tilt_y_rad``.
        socket_z_m: ``placement.socket_z_m``.
        socket_roll_rad: ``placement.socket_roll_rad``.
        socket_pitch_rad: ``placement.socket_pitch_rad``.
        socket_yaw_rad: ``placement.socket_yaw_rad``.
        grasp_x_m: ``placement.grasp_x_m``.
        grasp_y_m: ``placement.grasp_y_m``.
        grasp_z_m: ``placement.grasp_z_m``.
        grasp_roll_rad: ``placement.grasp_roll_rad``.
        grasp_pitch_rad: ``placement.grasp_pitch_rad``.
        grasp_yaw_rad: ``placement.grasp_yaw_rad``.
    """

    friction: Drawn = None
    contact_time_s: Drawn = None
    contact_damping: Drawn = None
    clearance_m: Drawn = None
    part_scale: Drawn = None
    kp_position: Drawn = None
    kp_orientation: Drawn = None
    damping_ratio: Drawn = None
    smoothing_s: Drawn = None
    goal_delay_s: Drawn = None
    dead_zone_n: Drawn = None
    dead_zone_nm: Drawn = None
    joint_friction_nm: Drawn = None
    joint_damping_nms: Drawn = None
    payload_kg: Drawn = None
    tilt_x_rad: Drawn = None
    tilt_y_rad: Drawn = None
    socket_z_m: Drawn = None
    socket_roll_rad: Drawn = None
    socket_pitch_rad: Drawn = None
    socket_yaw_rad: Drawn = None
    grasp_x_m: Drawn = None
    grasp_y_m: Drawn = None
    grasp_z_m: Drawn = None
    grasp_roll_rad: Drawn = None
    grasp_pitch_rad: Drawn = None
    grasp_yaw_rad: Drawn = None


AS_CONFIGURED = Physics()
"""Physics of a world without values of its own."""


def drawn(physics: Physics) -> dict[str, Any]:
    """Return the quantities that were drawn, by name."""
    values = {field.name: getattr(physics, field.name) for field in fields(Physics)}
    return {name: value for name, value in values.items() if value is not None}
