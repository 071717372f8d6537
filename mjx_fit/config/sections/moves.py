"""Configuration section of the moves between attempts, which are counted in time and not simulated."""

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from mjx_fit.config.sections.fields import STRICT


@dataclass(frozen=True, config=STRICT)
class MovesConfig:
    """Model of the time between two attempts: lift the peg, move above the next estimate, lower it, tare.

    Attributes:
        lift_m: Height of a move. It is above the start of an attempt.
        speed_mps: Speed of a move. 0.25 m/s is the limit for robots that share their space with people in
            reduced-speed operation (ISO 10218-1).
        acceleration_mps2: Acceleration of a move. Each of its three parts begins and ends at rest.
        settle_s: Rest before an attempt. The F/T sensor is tared in it.
    """

    lift_m: Annotated[float, Field(ge=0, le=0.5)] = 0.03
    speed_mps: Annotated[float, Field(ge=0.001, le=3, json_schema_extra={"unit": "m/s"})] = 0.25
    acceleration_mps2: Annotated[float, Field(ge=0.01, le=30, json_schema_extra={"unit": "m/s²"})] = 1.0
    settle_s: Annotated[float, Field(ge=0, le=10)] = 0.2
