"""Configuration section of the filter that knows the parts' geometry."""

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from mjx_fit.config.sections.fields import ACTIONS_UNIT, STRICT


@dataclass(frozen=True, config=STRICT)
class ParticlesConfig:
    """Particle filter on the geometry of contact (``mjx_fit.filters.particles``).

    Attributes:
        count: Number of particles.
        moves: Moves at each temperature. More mix better and take longer.
        settle: Rounds of moves after an attempt. They spread the particles as far as its rows allow.
        least_share: Effective share of particles. The next temperature leaves this share of them.
        every: Actions to a row. The wrench and the pose of the last of them are read.
        think_every: Actions to an update. That of an attempt in progress, by the policy seek.
        gap_std_m: Spread of the gap in contact. That between peg and socket, as measured poses give it; in
            the median of attempts.
        gap_spread: Spread of its logarithm. Between attempts, whose measurements are more or less noisy.
        pressure_std_m: Spread of the centre of pressure. About the points that touch.
        outlier_chance: Chance of a wrong row. Contact that the geometry of plate and edges does not explain,
            such as with the shaft of the peg.
        misled_chance: Chance of a misled belief. The place is then as far off as before any attempt.
        remember: Attempts remembered. Those at a hole that the same peg tries again, whose rows are then
            read again, and the policy seek goes where the particles are; 0: the belief after an attempt is a
            Gaussian, nothing else is known of it, and seek goes to its mean.
        remember_rows: Rows kept of each. Contact is preferred; they count more, since fewer are
            less correlated.
        row_weight: Exponent of a row's likelihood. Below 1, since the errors of rows are correlated.
        touch_n: Press of a contact. From this force on, the peg touches.
        free_n: Press in the air. Below this force it does not.
        grasp_std_m: Spread of the peg's shift. Per axis, in the hand; a rotation of the tool moves a peg that
            is held off its axis.
        grasp_std_rad: Spread of its turn. Per axis.
    """

    count: Annotated[int, Field(ge=64, le=65536)] = 256
    moves: Annotated[int, Field(ge=1, le=100)] = 12
    settle: Annotated[int, Field(ge=0, le=100)] = 3
    least_share: Annotated[float, Field(ge=0.1, le=0.9)] = 0.5
    every: Annotated[int, Field(ge=1, le=20, json_schema_extra=ACTIONS_UNIT)] = 2
    think_every: Annotated[int, Field(ge=1, le=1000, json_schema_extra=ACTIONS_UNIT)] = 10
    gap_std_m: Annotated[float, Field(ge=0.00002, le=0.005)] = 0.0001
    gap_spread: Annotated[float, Field(ge=0, le=3)] = 0.6
    pressure_std_m: Annotated[float, Field(ge=0.0005, le=0.05)] = 0.004
    outlier_chance: Annotated[float, Field(ge=0.001, le=0.9)] = 0.15
    misled_chance: Annotated[float, Field(ge=0, le=0.9)] = 0.1
    remember: Annotated[int, Field(ge=0, le=100)] = 0
    remember_rows: Annotated[int, Field(ge=1, le=1000)] = 25
    row_weight: Annotated[float, Field(ge=0.01, le=1)] = 0.45
    touch_n: Annotated[float, Field(ge=0.1, le=50)] = 2.0
    free_n: Annotated[float, Field(ge=0, le=50)] = 0.7
    grasp_std_m: Annotated[float, Field(ge=0, le=0.02)] = 0.0
    grasp_std_rad: Annotated[float, Field(ge=0, le=0.2)] = 0.0
