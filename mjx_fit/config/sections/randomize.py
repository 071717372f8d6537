"""Configuration section of randomised worlds: a distribution for any quantity that a world may own."""

from typing import Annotated

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from mjx_fit.config.sections.fields import STRICT

Number = Annotated[float, Field(ge=-10_000, le=10_000)]
NotNegative = Annotated[float, Field(ge=0, le=10_000)]
Positive = Annotated[float, Field(ge=1e-9, le=10_000)]
KINDS = ("uniform", "log_uniform", "normal", "choice")
MOST_SIGMA = 3.0
"""Draws of a normal distribution are clipped at this many standard deviations."""


@dataclass(frozen=True, config=STRICT)
class Distribution:
    """Distribution of a quantity; exactly one kind is given.

    Attributes:
        uniform: Lowest and highest value.
        log_uniform: Lowest and highest value, above 0, of a quantity whose logarithm is uniform.
        normal: Mean and standard deviation σ; draws are clipped at 3 σ.
        choice: Values of equal probability.
    """

    uniform: tuple[Number, Number] | None = None
    log_uniform: tuple[Positive, Positive] | None = None
    normal: tuple[Number, NotNegative] | None = None
    choice: Annotated[tuple[Number, ...], Field(min_length=1, max_length=100)] | None = None

    @model_validator(mode="after")
    def _is_one(self) -> "Distribution":
        given = [name for name in KINDS if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"{', '.join(given) or 'nothing'} is given: expected one of {', '.join(KINDS)}")
        low, high = self.support
        if low > high:
            raise ValueError(f"{given[0]}: [{low}, {high}] is invalid: expected the lowest value first")
        return self

    @property
    def support(self) -> tuple[float, float]:
        """Lowest and highest value."""
        if self.normal is not None:
            mean, std = self.normal
            return mean - MOST_SIGMA * std, mean + MOST_SIGMA * std
        if self.choice is not None:
            return min(self.choice), max(self.choice)
        bounds = self.uniform or self.log_uniform
        assert bounds is not None
        return bounds


@dataclass(frozen=True, config=STRICT)
class RandomizeConfig:
    """Distributions of what each world or reading draws; null: constant, as in its section.

    A world is one peg at one hole: all attempts of a sequence or a trial share its draws, which depend on the
    seed and the id alone. The sizes of measurement errors (sections ``wrist`` and ``pose``) are drawn like
    the errors themselves, when an attempt is read: traces are stored without errors.

    Attributes:
        friction: Of ``scene.friction``.
        contact_time_s: Of ``scene.contact_time_s``.
        contact_damping: Of ``scene.contact_damping``.
        clearance_m: Of ``scene.clearance_m``.
        part_scale: Of the parts' scale. All cross-sections, of pegs and holes alike; the clearance stays.
        kp_position: Of ``control.kp_position``.
        kp_orientation: Of ``control.kp_orientation``.
        damping_ratio: Of ``control.damping_ratio``.
        smoothing_s: Of ``control.smoothing_s``.
        goal_delay_s: Of ``control.goal_delay_s``.
        dead_zone_n: Of ``arm.dead_zone_n``.
        dead_zone_nm: Of ``arm.dead_zone_nm``.
        joint_friction_nm: Of ``arm.joint_friction_nm``.
        joint_damping_nms: Of ``arm.joint_damping_nms``.
        payload_kg: Of ``arm.payload_kg``.
        tilt_x_rad: Of ``arm.tilt_x_rad``.
        tilt_y_rad: Of ``arm.tilt_y_rad``.
        socket_z_m: Of ``placement.socket_z_m``.
        socket_roll_rad: Of ``placement.socket_roll_rad``.
        socket_pitch_rad: Of ``placement.socket_pitch_rad``.
        socket_yaw_rad: Of ``placement.socket_yaw_rad``.
        grasp_x_m: Of ``placement.grasp_x_m``.
        grasp_y_m: Of ``placement.grasp_y_m``.
        grasp_z_m: Of ``placement.grasp_z_m``.
        grasp_roll_rad: Of ``placement.grasp_roll_rad``.
        grasp_pitch_rad: Of ``placement.grasp_pitch_rad``.
        grasp_yaw_rad: Of ``placement.grasp_yaw_rad``.
        force_noise_n: Of ``wrist.force_noise_n``.
        torque_xy_noise_nm: Of ``wrist.torque_xy_noise_nm``.
        torque_z_noise_nm: Of ``wrist.torque_z_noise_nm``.
        force_bias_n: Of ``wrist.force_bias_n``.
        torque_bias_nm: Of ``wrist.torque_bias_nm``.
        force_drift_nps: Of ``wrist.force_drift_nps``.
        torque_drift_nmps: Of ``wrist.torque_drift_nmps``.
        gain_error: Of ``wrist.gain_error``.
        cross_talk: Of ``wrist.cross_talk``.
        bandwidth_hz: Of ``wrist.bandwidth_hz``.
        position_noise_m: Of ``pose.position_noise_m``.
        orientation_noise_rad: Of ``pose.orientation_noise_rad``.
        linear_noise_mps: Of ``pose.linear_noise_mps``.
        angular_noise_radps: Of ``pose.angular_noise_radps``.
        position_offset_m: Of ``pose.position_offset_m``.
        height_offset_m: Of ``pose.height_offset_m``.
        rotation_offset_rad: Of ``pose.rotation_offset_rad``.
        delay_s: Of ``pose.delay_s``.
    """

    friction: Distribution | None = None
    contact_time_s: Distribution | None = None
    contact_damping: Distribution | None = None
    clearance_m: Distribution | None = None
    part_scale: Distribution | None = None
    kp_position: Distribution | None = None
    kp_orientation: Distribution | None = None
    damping_ratio: Distribution | None = None
    smoothing_s: Distribution | None = None
    goal_delay_s: Distribution | None = None
    dead_zone_n: Distribution | None = None
    dead_zone_nm: Distribution | None = None
    joint_friction_nm: Distribution | None = None
    joint_damping_nms: Distribution | None = None
    payload_kg: Distribution | None = None
    tilt_x_rad: Distribution | None = None
    tilt_y_rad: Distribution | None = None
    socket_z_m: Distribution | None = None
    socket_roll_rad: Distribution | None = None
    socket_pitch_rad: Distribution | None = None
    socket_yaw_rad: Distribution | None = None
    grasp_x_m: Distribution | None = None
    grasp_y_m: Distribution | None = None
    grasp_z_m: Distribution | None = None
    grasp_roll_rad: Distribution | None = None
    grasp_pitch_rad: Distribution | None = None
    grasp_yaw_rad: Distribution | None = None
    force_noise_n: Distribution | None = None
    torque_xy_noise_nm: Distribution | None = None
    torque_z_noise_nm: Distribution | None = None
    force_bias_n: Distribution | None = None
    torque_bias_nm: Distribution | None = None
    force_drift_nps: Distribution | None = None
    torque_drift_nmps: Distribution | None = None
    gain_error: Distribution | None = None
    cross_talk: Distribution | None = None
    bandwidth_hz: Distribution | None = None
    position_noise_m: Distribution | None = None
    orientation_noise_rad: Distribution | None = None
    linear_noise_mps: Distribution | None = None
    angular_noise_radps: Distribution | None = None
    position_offset_m: Distribution | None = None
    height_offset_m: Distribution | None = None
    rotation_offset_rad: Distribution | None = None
    delay_s: Distribution | None = None
