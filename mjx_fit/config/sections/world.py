"""Configuration sections of control, policies, detector and F/T sensor."""

from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from mjx_fit.config.sections.fields import ACTIONS_UNIT, PER_S2_UNIT, STRICT

Push = Annotated[float, Field(ge=0.0005, le=0.02)]
Wiggle = Annotated[float, Field(ge=0, le=0.01)]
Tilt = Annotated[float, Field(ge=-0.05, le=0.05)]
YawSearch = Annotated[float, Field(ge=0, le=0.6)]
TiltSearch = Annotated[float, Field(ge=0, le=0.2)]
Spread = Annotated[float, Field(ge=0.0001, le=0.02)]


@dataclass(frozen=True, config=STRICT)
class ControlConfig:
    """Operational-space control, 500 Hz torque.

    Attributes:
        kp_position: Position stiffness over inertia. At 2000, a peg caught on an edge reached the joints'
            torque limits and tilted by 36°; at 1400, no peg tilted by more than 3°.
        kp_orientation: Rotation stiffness over inertia.
        damping_ratio: Damping ratio ζ of both. 1 would be critical if position and rotation were decoupled;
            they are not, and 1.2 keeps the overshoot of a 2 cm step below 5 % at every possible hole
            position.
        kp_posture: Posture stiffness over inertia. It acts in the null space of the task, critically damped.
        goal: Motion during an action. ``step``: the goal jumps at its start; ``ramp``: it moves from the
            previous goal to the next at constant speed.
        smoothing_s: Time constant of a low pass. It smooths the goal; 0: none.
        goal_delay_s: Delay of the goal. At most one action.
        push: Meaning of a vertical command. ``displacement``: it moves the goal, as in the paper, and the
            force follows from the stiffness; ``force``: it is a force, ``press_n`` for each 4 mm
            (``mjx_fit.control.force_control``).
        press_n: Force of a push of 4 mm. It applies to ``push: force``.
        press_speed_mps: Its speed in free space. It limits the impact on touch-down.
        slide_n: Largest lateral pull. It applies to ``push: force`` and limits the impact on edges.
        tilt_radps: Tilting speed at 0.1 N·m. In contact the tool gives way to torques at the TCP: a peg
            that leans then comes to lie flat (``mjx_fit.control.levelling``).
    """

    kp_position: Annotated[float, Field(ge=50, le=1400, json_schema_extra=PER_S2_UNIT)] = 600.0
    kp_orientation: Annotated[float, Field(ge=100, le=4000, json_schema_extra=PER_S2_UNIT)] = 600.0
    damping_ratio: Annotated[float, Field(ge=0.5, le=5)] = 1.2
    kp_posture: Annotated[float, Field(ge=0, le=400, json_schema_extra=PER_S2_UNIT)] = 10.0
    goal: Literal["step", "ramp"] = "ramp"
    smoothing_s: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    goal_delay_s: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    push: Literal["displacement", "force"] = "displacement"
    press_n: Annotated[float, Field(ge=0.5, le=30)] = 5.0
    press_speed_mps: Annotated[float, Field(ge=0.002, le=0.1, json_schema_extra={"unit": "m/s"})] = 0.01
    slide_n: Annotated[float, Field(ge=1, le=100)] = 12.0
    tilt_radps: Annotated[float, Field(ge=0, le=0.5, json_schema_extra={"unit": "rad/s"})] = 0.0


@dataclass(frozen=True, config=STRICT)
class ArmConfig:
    """Imperfections of the arm, unknown to its controller; all off by default.

    Attributes:
        dead_zone_n: Largest force without effect. Per axis of the commanded force, which is reduced by it: a
            simple model of friction in the drives, as in FORGE (Noseworthy et al., 2024).
        dead_zone_nm: Largest torque without effect. Likewise, about each axis of the world.
        joint_friction_nm: Coulomb friction of every joint.
        joint_damping_nms: Viscous joint friction. It adds to the model's, in every joint.
        payload_kg: Unknown mass at the tool. Gravity compensation omits it; its weight acts, not its inertia.
        tilt_x_rad: Tool's rotation about x. About the world's axis; the robot takes it for straight down.
        tilt_y_rad: Tool's rotation about y. Likewise.
    """

    dead_zone_n: Annotated[float, Field(ge=0, le=20)] = 0.0
    dead_zone_nm: Annotated[float, Field(ge=0, le=5)] = 0.0
    joint_friction_nm: Annotated[float, Field(ge=0, le=2)] = 0.0
    joint_damping_nms: Annotated[float, Field(ge=0, le=5, json_schema_extra={"unit": "N·m·s"})] = 0.0
    payload_kg: Annotated[float, Field(ge=-0.5, le=1, json_schema_extra={"unit": "kg"})] = 0.0
    tilt_x_rad: Tilt = 0.0
    tilt_y_rad: Tilt = 0.0


@dataclass(frozen=True, config=STRICT)
class SpiralConfig:
    """Spiral search policy, Algorithm 4 of the paper.

    Attributes:
        radius_m: Final radius r_max.
        turns: Revolutions n_rot in one attempt. 40 are already more than the end effector can follow.
        push_m: Goal δz below the TCP.
        wiggle_m: Exploration noise σ per axis. At most ``push_m``, since its mean upward component is 0.8 σ.
        yaw_rad: Amplitude of a search in yaw. The tool swings by it to both sides; 0: none, as in the paper.
        tilt_rad: Angle of a search in tilt. The tool leans by it, in a direction that goes round.
    """

    radius_m: Annotated[float, Field(ge=0.0001, le=0.18)] = 0.015
    turns: Annotated[float, Field(ge=0.01, le=40, json_schema_extra={"unit": "turns"})] = 2.0
    push_m: Push = 0.004
    wiggle_m: Wiggle = 0.00125
    yaw_rad: YawSearch = 0.0
    tilt_rad: TiltSearch = 0.0


@dataclass(frozen=True, config=STRICT)
class RandomConfig:
    """Random policy of data collection: sweeps between random way-points, pressed on the socket.

    Attributes:
        reach_m: Half width of the way-points. Way-points are uniform in it, around the estimate.
        actions_per_sweep: Actions between two way-points.
        push_m: Depth of the goal below the TCP.
        wiggle_m: Exploration noise σ per axis.
        yaw_rad: Largest yaw at a way-point. Uniform in it, to both sides; 0: none.
        tilt_rad: Largest tilt at a way-point. Likewise, about both axes.
    """

    reach_m: Annotated[float, Field(ge=0.0001, le=0.18)] = 0.025
    actions_per_sweep: Annotated[int, Field(ge=1, le=1000, json_schema_extra=ACTIONS_UNIT)] = 12
    push_m: Push = 0.004
    wiggle_m: Wiggle = 0.00125
    yaw_rad: YawSearch = 0.0
    tilt_rad: TiltSearch = 0.0


@dataclass(frozen=True, config=STRICT)
class DetectorConfig:
    """Simulated hole detector.

    Attributes:
        kind: Distribution of the error. Either ``square``: uniform per axis, or ``disc``: uniform direction
            and radius.
        half_width_m: Largest error per axis or radius. Per axis for ``square``, radius for ``disc``.
        prior_std_m: Initial σ of the belief per axis. In the paper Σ0 = σ_init I with σ_init = 1 cm².
        prior_std_z_m: Initial σ of the height. It applies if ``filter.coordinates`` names it; likewise below.
        prior_std_yaw_rad: Initial σ of the yaw.
        prior_std_tilt_rad: Initial σ of roll and pitch. Per axis.
    """

    kind: Literal["square", "disc"] = "square"
    half_width_m: Annotated[float, Field(ge=0, le=0.03)] = 0.02
    prior_std_m: Annotated[float, Field(ge=0.0001, le=0.1)] = 0.01
    prior_std_z_m: Annotated[float, Field(ge=0.0001, le=0.02)] = 0.003
    prior_std_yaw_rad: Annotated[float, Field(ge=0.001, le=0.6)] = 0.1
    prior_std_tilt_rad: Annotated[float, Field(ge=0.001, le=0.2)] = 0.03

    def prior_std(self, coordinate: str) -> float:
        """Return the initial σ of one of ``filter.coordinates``, m or rad."""
        others = {"z": self.prior_std_z_m, "yaw": self.prior_std_yaw_rad}
        others |= dict.fromkeys(("roll", "pitch"), self.prior_std_tilt_rad)
        return others.get(coordinate, self.prior_std_m)


@dataclass(frozen=True, config=STRICT)
class SequenceConfig:
    """Distribution of the estimates for later attempts of a collected sequence, as from a filter.

    Attributes:
        min_std_m: Smallest σ of a drawn estimate. It applies to each principal axis of the covariance.
        max_std_m: Largest σ of a drawn estimate. Both principal σ are log-uniform between these bounds, the
            direction of the axes is uniform.
    """

    min_std_m: Spread = 0.001
    max_std_m: Spread = 0.008

    @model_validator(mode="after")
    def _ordered(self) -> "SequenceConfig":
        if self.min_std_m > self.max_std_m:
            raise ValueError(f"min_std_m: {self.min_std_m} is invalid: expected at most max_std_m")
        return self
