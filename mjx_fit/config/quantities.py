"""Quantities that a world or a reading can have of its own, with their sections of the configuration."""

from typing import NamedTuple


class Quantity(NamedTuple):
    """Origin and unit of a quantity.

    Attributes:
        section: Section of the configuration that holds its constant value; empty: 1.
        unit: Its unit.
    """

    section: str
    unit: str


QUANTITIES = {
    "friction": Quantity("scene", "1"),
    "contact_time_s": Quantity("scene", "s"),
    "contact_damping": Quantity("scene", "1"),
    "clearance_m": Quantity("scene", "m"),
    "part_scale": Quantity("", "1"),
    "kp_position": Quantity("control", "1/s²"),
    "kp_orientation": Quantity("control", "1/s²"),
    "damping_ratio": Quantity("control", "1"),
    "smoothing_s": Quantity("control", "s"),
    "goal_delay_s": Quantity("control", "s"),
    "dead_zone_n": Quantity("arm", "N"),
    "dead_zone_nm": Quantity("arm", "N·m"),
    "joint_friction_nm": Quantity("arm", "N·m"),
    "joint_damping_nms": Quantity("arm", "N·m·s"),
    "payload_kg": Quantity("arm", "kg"),
    "tilt_x_rad": Quantity("arm", "rad"),
    "tilt_y_rad": Quantity("arm", "rad"),
    "socket_z_m": Quantity("placement", "m"),
    "socket_roll_rad": Quantity("placement", "rad"),
    "socket_pitch_rad": Quantity("placement", "rad"),
    "socket_yaw_rad": Quantity("placement", "rad"),
    "grasp_x_m": Quantity("placement", "m"),
    "grasp_y_m": Quantity("placement", "m"),
    "grasp_z_m": Quantity("placement", "m"),
    "grasp_roll_rad": Quantity("placement", "rad"),
    "grasp_pitch_rad": Quantity("placement", "rad"),
    "grasp_yaw_rad": Quantity("placement", "rad"),
}
"""Quantities that a world can have of its own, in the order of ``mjx_fit.types.physics.Physics``."""

MEASURED = {
    "force_noise_n": "wrist",
    "torque_xy_noise_nm": "wrist",
    "torque_z_noise_nm": "wrist",
    "force_bias_n": "wrist",
    "torque_bias_nm": "wrist",
    "force_drift_nps": "wrist",
    "torque_drift_nmps": "wrist",
    "gain_error": "wrist",
    "cross_talk": "wrist",
    "bandwidth_hz": "wrist",
    "position_noise_m": "pose",
    "orientation_noise_rad": "pose",
    "linear_noise_mps": "pose",
    "angular_noise_radps": "pose",
    "position_offset_m": "pose",
    "height_offset_m": "pose",
    "rotation_offset_rad": "pose",
    "delay_s": "pose",
}
"""Sizes of measurement errors that each reading can draw, and their sections."""

NUMERICAL = ("max_contacts",)
"""Keys of the world that limit the arithmetic of one engine: with enough slots the world is the same."""
