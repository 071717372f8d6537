"""Environment of a single insertion."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from jaxtyping import Float

from mjx_fit.config.schema import Config
from mjx_fit.envs.belief import BeliefReading
from mjx_fit.envs.insertion_batch import InsertionVectorEnv
from mjx_fit.envs.insertion_worlds import Engine
from mjx_fit.envs.reward import Reward
from mjx_fit.utils.errors import RequestError, shown


class InsertionEnv(gymnasium.Env):
    """One world of ``InsertionVectorEnv``: a peg at its own hole, whose place is detected with an error.

    Args:
        world: As in ``InsertionVectorEnv``.
        config: As there.
        reward: As there.
        engine: As there.
        belief: As there.

    Raises:
        RequestError: A value is invalid.
    """

    metadata = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        world: str | None = None,
        config: Config | None = None,
        reward: Reward = "dense",
        engine: Engine = "native",
        belief: BeliefReading | None = None,
    ):
        self._batch = InsertionVectorEnv(1, world, config, reward, AutoresetMode.DISABLED, engine, belief)
        self._began = False
        self.config = self._batch.config
        self.observation_space = self._batch.single_observation_space
        self.action_space = self._batch.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float[np.ndarray, "k"], dict[str, Any]]:
        """Begin the next episode; the first one, or one with a seed, begins a new series of episodes."""
        super().reset(seed=seed)
        if options:
            raise RequestError(f"options: {shown(next(iter(options)))} is unknown: expected none")
        if seed is None and self._began:
            observation, _ = self._batch.reset(options={"reset_mask": np.ones(1, bool)})
        else:
            observation, _ = self._batch.reset(seed=seed)
            self._began = True
        return observation[0], {}

    def step(self, action: Float[np.ndarray, "a"]) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Simulate an action; ``info`` of the last one says whether the peg is in, and its largest force."""
        observation, reward, terminated, truncated, told = self._batch.step(np.asarray(action)[None])
        info = {name: told[name][0] for name in ("inserted", "largest_n") if name in told}
        return observation[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), info
