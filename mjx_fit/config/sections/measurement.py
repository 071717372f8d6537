"""Configuration sections of what a robot measures: its wrist F/T sensor, and pose and twist of the TCP."""

from dataclasses import replace
from typing import Annotated

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from mjx_fit.config.sections.fields import STRICT
from mjx_fit.utils.rates import STEP_S

Share = Annotated[float, Field(ge=0, le=0.5)]


@dataclass(frozen=True, config=STRICT)
class WristConfig:
    """Wrist force/torque (F/T) sensor. Noise: Robotiq FT 300-S, 1 σ per sample.

    Errors that are constant in an attempt are drawn once per reading. In the world ``paper`` there is noise
    alone.

    Attributes:
        force_noise_n: Noise σ of Fx, Fy and Fz.
        torque_xy_noise_nm: Noise σ of Tx and Ty.
        torque_z_noise_nm: Noise σ of Tz.
        tare_samples: Samples averaged for the tare. 100,000 take 200 s.
        contact_force_n: RMS force that counts as contact. It is tared and taken over one action; noise alone
            gives √3 σ.
        force_bias_n: Force left by taring. σ per axis and attempt.
        torque_bias_nm: Torque left by taring. σ per axis and attempt.
        force_drift_nps: Drift of the forces. σ per axis and attempt.
        torque_drift_nmps: Drift of the torques. σ per axis and attempt.
        gain_error: Relative error of the gain. σ per axis and attempt.
        cross_talk: Share of another axis in each. σ per pair of axes and attempt, among forces and among
            torques.
        bandwidth_hz: Cut-off of a first-order low pass. Null: none.
        rate_hz: Sampling rate, held in between. 500 Hz divided by a whole number; null: 500 Hz, as simulated.
        force_range_n: Saturation of the forces. It includes the tare; null: none.
        torque_range_nm: Saturation of the torques. It includes the tare; null: none.
    """

    force_noise_n: Annotated[float, Field(ge=0, le=30)] = 0.1
    torque_xy_noise_nm: Annotated[float, Field(ge=0, le=3)] = 0.005
    torque_z_noise_nm: Annotated[float, Field(ge=0, le=3)] = 0.003
    tare_samples: Annotated[int, Field(ge=1, le=100_000, json_schema_extra={"unit": "samples"})] = 50
    contact_force_n: Annotated[float, Field(ge=0.01, le=50)] = 1.0
    force_bias_n: Annotated[float, Field(ge=0, le=10)] = 0.3
    torque_bias_nm: Annotated[float, Field(ge=0, le=1)] = 0.01
    force_drift_nps: Annotated[float, Field(ge=0, le=1, json_schema_extra={"unit": "N/s"})] = 0.01
    torque_drift_nmps: Annotated[float, Field(ge=0, le=0.1, json_schema_extra={"unit": "N·m/s"})] = 0.0003
    gain_error: Share = 0.03
    cross_talk: Share = 0.01
    bandwidth_hz: Annotated[float, Field(ge=1, le=250, json_schema_extra={"unit": "Hz"})] | None = None
    rate_hz: Annotated[float, Field(ge=10, le=500, json_schema_extra={"unit": "Hz"})] | None = None
    force_range_n: Annotated[float, Field(ge=10, le=10_000)] | None = None
    torque_range_nm: Annotated[float, Field(ge=1, le=1000)] | None = None

    @model_validator(mode="after")
    def _held_for_whole_steps(self) -> "WristConfig":
        if self.rate_hz is not None:
            nearest = 1 / (STEP_S * round(1 / (STEP_S * self.rate_hz)))
            if abs(self.rate_hz - nearest) > 0.01:
                raise ValueError(
                    f"rate_hz: {self.rate_hz} is invalid: expected 500 divided by a whole number, "
                    f"such as {nearest:.2f}"
                )
        return self

    def without_errors(self) -> "WristConfig":
        """Return an F/T sensor that adds no errors, with the same taring and the same contact threshold."""
        limits = dict.fromkeys(("bandwidth_hz", "rate_hz", "force_range_n", "torque_range_nm"))
        errors = vars(self).keys() - limits.keys() - {"tare_samples", "contact_force_n"}
        return replace(self, **dict.fromkeys(errors, 0.0), **limits)


@dataclass(frozen=True, config=STRICT)
class PoseConfig:
    """Measured pose and twist of the tool centre point (TCP).

    Policies see the noise, the resolution and the delay, not the calibration errors, which act where a sensor
    reads the trace. The calibration errors are FORGE's (Noseworthy et al., 2024) and those of arms' data
    sheets; the world ``paper`` has exact readings.

    Attributes:
        position_noise_m: Noise σ of the position. Per sample and axis.
        orientation_noise_rad: Noise σ of the orientation. Per sample, about each axis.
        linear_noise_mps: Noise σ of the linear velocity. Per sample and axis.
        angular_noise_radps: Noise σ of the angular velocity. Per sample and axis.
        position_offset_m: Calibration error of the position. σ per horizontal axis and attempt; it moves the
            whole trace against the estimate of the hole.
        height_offset_m: Calibration error of the height. σ per attempt, that of the table included.
        rotation_offset_rad: Calibration error of rotations. σ about each axis and attempt; a reading
            relative to the start (``sensor.pose``) is free of it.
        position_step_m: Resolution of the position. 0: exact.
        orientation_step_rad: Resolution of the orientation. 0: exact.
        delay_s: Delay behind the wrench.
    """

    position_noise_m: Annotated[float, Field(ge=0, le=0.01)] = 0.00005
    orientation_noise_rad: Annotated[float, Field(ge=0, le=0.1)] = 0.00035
    linear_noise_mps: Annotated[float, Field(ge=0, le=0.1, json_schema_extra={"unit": "m/s"})] = 0.001
    angular_noise_radps: Annotated[float, Field(ge=0, le=1, json_schema_extra={"unit": "rad/s"})] = 0.002
    position_offset_m: Annotated[float, Field(ge=0, le=0.01)] = 0.00025
    height_offset_m: Annotated[float, Field(ge=0, le=0.01)] = 0.0003
    rotation_offset_rad: Annotated[float, Field(ge=0, le=0.1)] = 0.001745
    position_step_m: Annotated[float, Field(ge=0, le=0.001)] = 0.0
    orientation_step_rad: Annotated[float, Field(ge=0, le=0.01)] = 0.0
    delay_s: Annotated[float, Field(ge=0, le=0.1)] = 0.0

    def without_errors(self) -> "PoseConfig":
        """Return a measurement that adds no errors."""
        return replace(self, **dict.fromkeys(vars(self), 0.0))
