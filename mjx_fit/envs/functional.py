"""The environment as pure functions on MJX, for those who train inside ``jax.jit``."""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int, Key

from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config
from mjx_fit.config.worlds import world_file
from mjx_fit.data.schedule import draw_matching
from mjx_fit.engines.mjx.compiler import compiler_options
from mjx_fit.engines.mjx.stepped import Ongoing, SteppedWorld
from mjx_fit.envs.observation import commanded, observed, size, width
from mjx_fit.envs.outcome import outcome, require_for_envs, worth_at_start
from mjx_fit.envs.reward import Reward
from mjx_fit.types import Array, pytree
from mjx_fit.utils import numerics
from mjx_fit.utils.errors import RequestError


@pytree
class InsertionState:
    """State of one world between actions.

    Attributes:
        now: The attempt and its simulation.
        key: Key of all episodes of this world.
        episode: Number of episodes before this one.
        command: Command of the previous action, m and rad.
        worth: Potential of the place where the peg is (``reward.worth``).
        observation: What is observed now.
    """

    now: Ongoing
    key: Key[Array, ""]
    episode: Int[Array, ""]
    command: Float[Array, "a"]
    worth: Float[Array, ""]
    observation: Float[Array, "k"]


@pytree
class InsertionStep:
    """What an action led to.

    Attributes:
        observation: Observation after the action; the first one of the next episode, if this one is over.
        last_observation: Observation after the action, in any case; where a simulation diverged, before it.
        reward: Reward.
        terminated: Whether the peg is in, or the simulation diverged.
        truncated: Whether the time of the attempt is over.
        inserted: Whether the peg is in.
        largest_n: Largest contact force of the action, N; infinite in a simulation that diverged.
    """

    observation: Float[Array, "k"]
    last_observation: Float[Array, "k"]
    reward: Float[Array, ""]
    terminated: Bool[Array, ""]
    truncated: Bool[Array, ""]
    inserted: Bool[Array, ""]
    largest_n: Float[Array, ""]


class FunctionalInsertion:
    """The environment ``mjx_fit/Insertion-v0`` of one world, for ``jax.vmap`` and ``jax.jit``.

    Args:
        world: As in ``InsertionVectorEnv``.
        config: As there.
        reward: As there.

    Attributes:
        config: The configuration.
        observation_size: Number k of components of an observation.
        action_size: Number a of components of an action.
        compiler_options: Options for ``jax.jit``; without them MJX is many times slower on a CPU.

    Raises:
        RequestError: A value is invalid.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> from mjx_fit.envs.functional import FunctionalInsertion
        >>> env = FunctionalInsertion()
        >>> reset = jax.jit(jax.vmap(env.reset), compiler_options=env.compiler_options)
        >>> reset(jax.random.split(jax.random.key(0), 2)).observation.shape
        (2, 27)
    """

    def __init__(self, world: str | None = None, config: Config | None = None, reward: Reward = "dense"):
        numerics.require()
        if world is not None and config is not None:
            raise RequestError("world: it cannot be used beside config, which has a world of its own")
        self.config = read_config(world_file(world)) if config is None else config
        require_for_envs(self.config, reward)
        self._kind: Reward = reward
        self.observation_size, self.action_size = size(self.config), width(self.config)
        self.compiler_options = compiler_options()
        self._world = SteppedWorld.of(self.config)

    def reset(self, key: Key[Array, ""]) -> InsertionState:
        """Begin the first episode of a world. All of its episodes depend on the key alone."""
        return self._begun(key, jnp.int32(0))

    def step(self, state: InsertionState, action: Float[Array, "a"]) -> tuple[InsertionState, InsertionStep]:
        """Simulate an action in [-1, 1]. The next episode begins within the step that ends one."""
        command = commanded(action)
        now, stepped = self._world.act(state.now, command)
        judged = outcome(stepped, now.attempt.hole_pos_world, state.worth, self._kind, self.config)
        truncated = ~judged.terminated & (now.step >= self.config.task.attempt_actions)
        seen = observed(self._world.seen(now), command, self.config)
        seen = jnp.where(judged.valid, seen, state.observation)
        over = judged.terminated | truncated
        on = InsertionState(now, state.key, state.episode, command, judged.worth, seen)
        new = self._begun(state.key, state.episode + 1)
        after = jax.tree.map(partial(jnp.where, over), new, on)
        return after, InsertionStep(
            after.observation,
            seen,
            judged.reward,
            judged.terminated,
            truncated,
            judged.inserted,
            judged.largest_n,
        )

    def _begun(self, key: Key[Array, ""], episode: Int[Array, ""]) -> InsertionState:
        attempt = draw_matching(jax.random.fold_in(key, episode), self.config)
        now, still = self._world.begin(attempt), jnp.zeros(self.action_size)
        seen = observed(self._world.seen(now), still, self.config)
        return InsertionState(now, key, episode, still, worth_at_start(attempt, self.config), seen)
