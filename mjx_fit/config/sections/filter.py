"""Configuration section of the filters: safeguards against wrong readings."""

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from mjx_fit.config.sections.fields import STRICT


@dataclass(frozen=True, config=STRICT)
class FilterConfig:
    """Safeguards of the belief updates against wrong readings; off in the paper.

    Correlation and temperature were fitted for the weights that ship (``experiments/robust/safeguards.py``).

    Attributes:
        gate: Probability of acceptance. 0: any reading is accepted. A reading outside the region of this
            probability, under the belief and its own R, moves the belief as before but makes it less certain
            (``mjx_fit.filters.kalman.gated``).
        correlation: Correlation of readings. That of their errors at one hole, ρ; later readings then count
            less (``mjx_fit.filters.kalman.correlated``); 0: independent, as in the paper.
        match_temperature: Divisor of the logits of h_match. Above 1, the match classification counts less.
        position_temperature: Factor of R. Above 1, the measured position counts less.
    """

    gate: Annotated[float, Field(ge=0, le=0.99999)] = 0.99
    correlation: Annotated[float, Field(ge=0, le=0.95)] = 0.1
    match_temperature: Annotated[float, Field(ge=0.1, le=100)] = 1.14
    position_temperature: Annotated[float, Field(ge=0.1, le=100)] = 1.0
