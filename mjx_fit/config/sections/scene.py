"""Configuration section of robot, geometry and contact."""

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from mjx_fit.config.sections.fields import STRICT
from mjx_fit.config.sections.shape import SHAPES, Shape
from mjx_fit.utils.rates import STEP_S

RobotName = Literal["panda"]
"""Keys of ``mjx_fit.scene.robot.ROBOTS``; a test checks that they agree."""

MOST_TYPES = 12
"""Maximum number of shapes in a scene, limited by the number of distinguishable colours."""


LEAST_CONTACT_TIME_S = 0.0005
LEAST_STEPS, STIFF_STEPS = 2, 2.2
"""Physics steps in the time constant of a contact: at least, and where the clearance sets it."""
_ALMOST = 0.999
"""Rounding of a quotient is no reason for another step."""


@dataclass(frozen=True, config=STRICT)
class SceneConfig:
    """Robot, geometry and contact.

    Attributes:
        robot: Name of the arm. It is defined in ``mjx_fit.scene.robot``.
        shapes: Cross-sections of pegs and holes. One per type, 1 to 12, with distinct names.
        clearance_m: Gap between peg and hole per side. A shape may have its own.
        plate_half_width_m: Half the side of the socket. It must cover the largest detector error
            (2.83 cm), the spiral radius (1.5 cm) and half a peg (2 cm for the default shapes).
        hole_depth_m: Depth of the hole to its floor.
        peg_length_m: Length below the F/T sensor.
        start_height_m: Height of starts. Of the TCP above the plate, at rest, before an attempt.
        friction: Coulomb friction, peg and socket. The default is typical of two dry, smooth plastics or
            metals.
        contact_time_s: MuJoCo's solref time constant. With ten simulation steps the contact force of a
            sliding peg is mostly smooth; with three it is a train of single-step spikes. Shapes with a
            section or a clearance of their own have at most ``contact_time_per_gap`` times the clearance.
        contact_time_per_gap: Longest contact time per gap. With 11 s/m, 99.9 % of
            penetrations of NIST's pegs stay below a tenth of their clearances (experiments/parts/right.py).
            A larger one is softer and faster: it needs fewer physics steps.
        contact_width_m: MuJoCo's solimp width. The impedance changes over this depth; keep it below a quarter
            of the clearance. Shapes with a section or a clearance of their own have at most a tenth of it.
        contact_damping: MuJoCo's solref damping ratio. 1: critical.
        contact_impedance: MuJoCo's solimp dmin. The impedance d of a touching contact; its weight D in the
            solver grows as d / (1 - d).
        deep_impedance: MuJoCo's solimp dmax. The impedance beyond the depth ``contact_width_m``; a high one
            bounds the penetration in impacts.
        slip_time_s: MuJoCo's solreffriction. Friction brakes a sliding peg at the rate b = 2 /
            (deep_impedance slip_time_s); null: equal to ``contact_time_s``. MuJoCo's convex friction cone
            lifts a peg that slides at speed v with the force D μ b v; where this exceeds the push, the peg
            loses contact (experiments/physics/sliding.py).
        steps_per_torque: Physics steps per torque of 2 ms. Null: as few as the contact of the smallest
            clearance needs.
        max_contacts: Contact slots per world in MJX. A pressed peg of the default shapes has up to 24 points
            in C, one of three or four rectangles up to 33; if slots are too few, the deepest points count,
            and torques differ.
    """

    robot: RobotName = "panda"
    shapes: Annotated[tuple[Shape, ...], Field(min_length=1, max_length=MOST_TYPES)] = SHAPES
    clearance_m: Annotated[float, Field(ge=0.0001, le=0.005)] = 0.001
    plate_half_width_m: Annotated[float, Field(ge=0.08, le=0.2)] = 0.08
    hole_depth_m: Annotated[float, Field(ge=0.01, le=0.08)] = 0.035
    peg_length_m: Annotated[float, Field(ge=0.05, le=0.15)] = 0.07
    start_height_m: Annotated[float, Field(ge=0.001, le=0.05)] = 0.002
    friction: Annotated[float, Field(ge=0, le=2)] = 0.3
    contact_time_s: Annotated[float, Field(ge=LEAST_CONTACT_TIME_S, le=0.05)] = 0.01
    contact_time_per_gap: Annotated[float, Field(ge=2, le=100, json_schema_extra={"unit": "s/m"})] = 11.0
    contact_width_m: Annotated[float, Field(ge=0.000001, le=0.001)] = 0.0001
    contact_damping: Annotated[float, Field(ge=0.5, le=5)] = 1.0
    contact_impedance: Annotated[float, Field(ge=0.1, le=0.99)] = 0.3
    deep_impedance: Annotated[float, Field(ge=0.1, le=0.99)] = 0.95
    slip_time_s: Annotated[float, Field(ge=0.004, le=0.5)] | None = 0.05
    steps_per_torque: Annotated[int, Field(ge=1, le=20, json_schema_extra={"unit": "steps"})] | None = None
    max_contacts: Annotated[int, Field(ge=4, le=64, json_schema_extra={"unit": "contacts"})] = 24

    @model_validator(mode="after")
    def _names_differ(self) -> "SceneConfig":
        if len(set(self.names)) < self.n_types:
            raise ValueError(f"shapes: {', '.join(self.names)} cannot be used: the names must differ")
        return self

    @model_validator(mode="after")
    def _stiffer_with_depth(self) -> "SceneConfig":
        if self.contact_impedance > self.deep_impedance:
            raise ValueError(
                f"contact_impedance: {self.contact_impedance} is invalid: expected at most deep_impedance "
                f"({self.deep_impedance})"
            )
        return self

    def clearance_of(self, shape: Shape) -> float:
        """Return the gap of a part per side, m."""
        return self.clearance_m if shape.clearance_m is None else shape.clearance_m

    def contact_time_limit_of(self, shape: Shape) -> float:
        """Return the longest time constant of a part's contact, s: infinite for plain parts.

        A peg that lands is stopped within a depth that grows with its speed and the time constant;
        ``contact_time_per_gap`` keeps that depth a small share of the gap.
        """
        if shape.section is None and shape.clearance_m is None:
            return math.inf
        return self.contact_time_per_gap * self.clearance_of(shape)

    def contact_time_of(self, shape: Shape) -> float:
        """Return the time constant of a part's contact, s."""
        return min(self.contact_time_s, self.contact_time_limit_of(shape))

    @property
    def physics_steps(self) -> int:
        """Number of physics steps per torque."""
        if self.steps_per_torque is not None:
            return self.steps_per_torque
        stiffest = min(self.contact_time_limit_of(shape) for shape in self.shapes)
        return max(self.least_physics_steps, math.ceil(_ALMOST * STIFF_STEPS * STEP_S / stiffest))

    @property
    def least_physics_steps(self) -> int:
        """Number of physics steps per torque with which the shortest contact time lasts two of them."""
        shortest = min(self.contact_time_of(shape) for shape in self.shapes)
        return max(1, math.ceil(_ALMOST * LEAST_STEPS * STEP_S / shortest))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the shapes."""
        return tuple(shape.name for shape in self.shapes)

    @property
    def n_types(self) -> int:
        """Number of shapes, C."""
        return len(self.shapes)
