"""Configuration section of the filters: what is believed, and safeguards against wrong readings."""

from typing import Annotated, Literal, get_args

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from mjx_fit.config.sections.fields import STRICT

Coordinate = Literal["x", "y", "z", "yaw", "roll", "pitch"]
COORDINATES: tuple[str, ...] = get_args(Coordinate)
PLANAR: tuple[Coordinate, ...] = ("x", "y")
"""What the paper's belief is about."""


@dataclass(frozen=True, config=STRICT)
class FilterConfig:
    """Coordinates of the belief, and safeguards of its updates against wrong readings; off in the paper.

    Correlation and temperature were fitted for the weights that ship (``experiments/robust/safeguards.py``).

    Attributes:
        coordinates: What is believed of a socket. The paper's x and y, then any others: z is its height over
            the nominal one; yaw, roll and pitch are rotations about the world's z, x and y
            (``mjx_fit.filters.chart``). What is not believed is taken to be nominal.
        reads: What reads an attempt. The trained ``sensor``; or the ``geometry`` of the parts, which needs no
            training: a particle filter (section ``particles``) asks which places explain the contact.
        grasp_std_m: Spread σ of grasps. That of positions, per axis, as part of the detector's initial σ.
            Above 0, the holes of an assembly share the grasp of the peg in hand: what is felt at one corrects
            the others (``mjx_fit.filters.joint``); 0: they share nothing, as in the paper.
        grasp_std_rad: Spread σ of turns in the hand. Per axis, likewise.
        gate: Probability of acceptance. 0: any reading is accepted. A reading outside the region of this
            probability, under the belief and its own R, moves the belief as before but makes it less certain
            (``mjx_fit.filters.kalman.gated``).
        correlation: Correlation of readings. That of their errors at one hole, ρ; later readings then count
            less (``mjx_fit.filters.kalman.correlated``); 0: independent, as in the paper.
        match_temperature: Divisor of the logits of h_match. Above 1, the match classification counts less.
        position_temperature: Factor of R. Above 1, the measured position counts less.
        capture_m: Distance at which a peg drops. One that passes its hole this close may go in; for second
            visits (``task.revisit_from: map``).
        capture_chance: Probability that it does. Of a peg that passes right over its hole.
        misled_chance: Share of visits misled. Of those in vain; the map of second visits doubts what
            was felt by as much (``mjx_fit.filters.search_map``).
    """

    coordinates: Annotated[tuple[Coordinate, ...], Field(min_length=2, max_length=6)] = PLANAR
    reads: Literal["sensor", "geometry"] = "sensor"
    grasp_std_m: Annotated[float, Field(ge=0, le=0.02)] = 0.0
    grasp_std_rad: Annotated[float, Field(ge=0, le=0.2)] = 0.0
    gate: Annotated[float, Field(ge=0, le=0.99999)] = 0.99
    correlation: Annotated[float, Field(ge=0, le=0.95)] = 0.1
    match_temperature: Annotated[float, Field(ge=0.1, le=100)] = 1.14
    position_temperature: Annotated[float, Field(ge=0.1, le=100)] = 1.0
    capture_m: Annotated[float, Field(ge=0.0001, le=0.01)] = 0.0008
    capture_chance: Annotated[float, Field(ge=0.01, le=0.999)] = 0.8
    misled_chance: Annotated[float, Field(ge=0.01, le=0.99)] = 0.5

    @property
    def shares_grasp(self) -> bool:
        """Whether the holes of an assembly share the grasp of the peg in hand."""
        return self.grasp_std_m > 0 or self.grasp_std_rad > 0

    @model_validator(mode="after")
    def _ordered(self) -> "FilterConfig":
        asked = self.coordinates
        if asked[:2] != PLANAR or list(asked) != [name for name in COORDINATES if name in asked]:
            raise ValueError(
                f"coordinates: [{', '.join(asked)}] is invalid: expected x and y, then any of "
                f"{', '.join(COORDINATES[2:])}, in this order"
            )
        return self
