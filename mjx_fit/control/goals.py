"""Motion of the controller's goal during an action."""

from jaxtyping import Float, Int

from mjx_fit.config.sections.world import ControlConfig
from mjx_fit.types import SUBSTEPS, Array


def goal_during(
    before_world: Float[Array, "*n 3"],
    after_world: Float[Array, "*n 3"],
    substep: int | Int[Array, ""],
    control: ControlConfig,
) -> Float[Array, "*n 3"]:
    """Compute the goal of the TCP in one simulation step of an action, m.

    Mode ``step`` is a jump by the whole command, which the arm answers with a torque step. Mode ``ramp``
    interpolates linearly at the rate of the torques, as the controllers of VICES (Martín-Martín et al., 2019)
    do.

    Args:
        before_world: Goal at the end of the previous action, m.
        after_world: Goal of this action, m.
        substep: Index of the simulation step in the action, from 0.
        control: Defines the mode.
    """
    if control.goal == "step":
        return after_world
    return before_world + (substep + 1) / SUBSTEPS * (after_world - before_world)
