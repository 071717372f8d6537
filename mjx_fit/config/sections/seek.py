"""Configuration section of the search that acts on a belief while it touches."""

from typing import Annotated, Any

from pydantic import Field
from pydantic.dataclasses import dataclass

from mjx_fit.config.sections.fields import STRICT
from mjx_fit.config.sections.world import Push

_SPEED: dict[str, Any] = {"unit": "m/s"}


@dataclass(frozen=True, config=STRICT)
class SeekConfig:
    """Search policy ``seek``: an Archimedean spiral about the believed position, begun anew when it pays.

    Attributes:
        pitch_m: Distance between turns. Twice the clearance leaves no gap; more is faster.
        speed_mps: Speed along the spiral.
        slide_mps: Speed of a change of centre. The peg is not lifted.
        turn_radps: Speed of turns. The tool follows the believed rotation, where one is believed.
        rock: Size of the search in rotation. In contact the tool rocks about the believed rotation by
            this many believed standard deviations, where a rotation is believed.
        probe_radpm: Tilt for each metre of doubt. The tool rocks by as much more, times the standard
            deviation of the believed position: the rim of the peg feels where the plate ends.
        probe_most_rad: Largest such tilt.
        change_s: Time that a new centre costs. The rule adds it for slowing down and starting anew.
        feel_s: Longest search that is expected. Contact then tells where the hole is, for any belief.
        sink_s: Time to push the peg in.
        drop_m: Depth that tells the hole. A TCP this far below its first contact has dropped into something;
            the goal then waits there. It lies above the noise of heights, and above what an edge yields.
        raster_m: Half width of what raster sweeps. This policy sweeps its square with the same pitch, speeds
            and pushes, without a belief.
        lean_rad: Angle of policy tilt. Its peg leans by it in the direction of its motion until it drops;
            pitch, speeds and pushes are those of seek, without a belief.
        approach_push_m: Vertical command before contact. It sets the speed of the touch-down.
        push_m: Command in contact, downwards.
        deep_push_m: Vertical command after a drop. The peg has found an edge and is going in.
        astray_share: Share of spells led astray. Such a spell of 2 s searches about a place drawn from the
            belief before the attempt; for the collection of data, where a peg that is always led by a belief
            would tell the hole by its place alone.
    """

    pitch_m: Annotated[float, Field(ge=0.0002, le=0.02)] = 0.0015
    speed_mps: Annotated[float, Field(ge=0.001, le=0.1, json_schema_extra=_SPEED)] = 0.02
    slide_mps: Annotated[float, Field(ge=0.001, le=0.1, json_schema_extra=_SPEED)] = 0.03
    turn_radps: Annotated[float, Field(ge=0.01, le=3, json_schema_extra={"unit": "rad/s"})] = 0.3
    rock: Annotated[float, Field(ge=0, le=5)] = 0.0
    probe_radpm: Annotated[float, Field(ge=0, le=100, json_schema_extra={"unit": "rad/m"})] = 0.0
    probe_most_rad: Annotated[float, Field(ge=0, le=0.3)] = 0.1
    change_s: Annotated[float, Field(ge=0, le=10)] = 0.2
    feel_s: Annotated[float, Field(ge=0.1, le=100)] = 2.0
    sink_s: Annotated[float, Field(ge=0, le=100)] = 1.0
    drop_m: Annotated[float, Field(ge=0.00005, le=0.01)] = 0.0012
    raster_m: Annotated[float, Field(ge=0.0005, le=0.1)] = 0.01
    lean_rad: Annotated[float, Field(ge=0, le=0.2)] = 0.05
    approach_push_m: Push = 0.0025
    push_m: Push = 0.004
    deep_push_m: Push = 0.006
    astray_share: Annotated[float, Field(ge=0, le=1)] = 0.0
