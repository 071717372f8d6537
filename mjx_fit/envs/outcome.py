"""What an action of an environment led to: pure functions of one world."""

import jax.numpy as jnp
from jaxtyping import Bool, Float

from mjx_fit.config.schema import Config
from mjx_fit.engines.stepped import Stepped
from mjx_fit.envs import reward
from mjx_fit.envs.reward import Reward
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.scene.variation import require_drawable
from mjx_fit.types import Array, Attempt, pytree
from mjx_fit.utils.errors import RequestError, shown


@pytree
class Outcome:
    """Outcome of an action.

    Attributes:
        reward: Reward.
        terminated: Whether the peg is in, or the simulation diverged.
        inserted: Whether the peg is in.
        valid: Whether the simulation is plausible.
        largest_n: Largest contact force of the action, N; infinite in a simulation that diverged.
        worth: Potential of the place where the peg is now (``reward.worth``).
    """

    reward: Float[Array, "*n"]
    terminated: Bool[Array, "*n"]
    inserted: Bool[Array, "*n"]
    valid: Bool[Array, "*n"]
    largest_n: Float[Array, "*n"]
    worth: Float[Array, "*n"]


def outcome(
    stepped: Stepped, hole_pos_world: Float[Array, "2"], worth: Float[Array, ""], kind: Reward, config: Config
) -> Outcome:
    """Judge an action, given the potential before it."""
    verdict = stepped.verdict
    inserted, valid = jnp.asarray(verdict.inserted), jnp.asarray(verdict.valid)
    largest = jnp.linalg.norm(stepped.wrench_sensor[..., :3], axis=-1).max(-1)
    place = jnp.where(valid, stepped.peg.pos_world, 0.0)
    now = jnp.where(valid, reward.worth(place, hole_pos_world, config), worth)
    earned = inserted.astype(float)
    if kind == "dense":
        earned = reward.dense(now - worth, largest, inserted, valid)
    return Outcome(earned, verdict.over, inserted, valid, jnp.where(valid, largest, jnp.inf), now)


def worth_at_start(attempt: Attempt, config: Config) -> Float[Array, ""]:
    """Return the potential of the place where the detection is."""
    above = jnp.append(attempt.estimate_world[:2], plate_top_m(config.scene))
    return reward.worth(above, attempt.hole_pos_world, config)


def require_for_envs(config: Config, kind: Reward) -> None:
    """Check that the environments support a configuration and a reward.

    Raises:
        RequestError: They do not.
    """
    if not isinstance(config, Config):
        raise RequestError(f"config: {shown(config)} is invalid: expected a Config, as of load_config")
    if kind not in reward.REWARDS:
        raise RequestError(f"reward: {shown(kind)} is invalid: expected one of {', '.join(reward.REWARDS)}")
    if config.placement.grip_n:
        raise RequestError(
            f"config: placement.grip_n: {config.placement.grip_n:g} is invalid: environments have 0"
        )
    if config.task.success != "truth":
        raise RequestError(
            f"config: task.success: {config.task.success} is invalid: environments end by the truth"
        )
    require_drawable(config)
