"""Vectorised environment of single insertions, on the batch of an engine."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Float

from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config
from mjx_fit.config.worlds import world_file
from mjx_fit.envs.belief import COMPONENTS, BeliefReader, BeliefReading
from mjx_fit.envs.insertion_worlds import ENGINES, Engine, InsertionWorlds, Transition
from mjx_fit.envs.observation import size, width
from mjx_fit.envs.outcome import require_for_envs
from mjx_fit.envs.reward import Reward
from mjx_fit.utils.errors import RequestError, require, shown
from mjx_fit.utils.randomness import require_seed, root_key

MOST_ENVS = 65536
_TOLD = ("inserted", "largest_n")
"""What ``info`` says of episodes that end."""


class InsertionVectorEnv(VectorEnv):
    """A peg at its own hole, whose place is detected with an error, in ``num_envs`` worlds at once.

    An episode is an attempt: it starts above the detection, and ends with the insertion, a simulation that
    diverges, or ``task.attempt_actions`` actions. An action is 0.1 s of motion and push, and of orientation
    where a rotation is believed, in [-1, 1]³ or [-1, 1]⁶ (``envs.observation.commanded``); observations hold
    what a robot has (``envs.observation.observed``).

    Args:
        num_envs: Number of worlds.
        world: Name of a world; None: the default, or that of ``config``.
        config: Configuration, with parts and randomisation; None: that of ``world``.
        reward: ``dense`` or ``sparse`` (``envs.reward``).
        autoreset_mode: As in Gymnasium: ``NextStep`` (an episode begins with the step after its last, whose
            action is ignored), ``SameStep`` (within it; what was last observed and told is in the info, as
            ``final_obs`` and ``final_info``), or
            ``Disabled`` (by ``reset`` with ``options={"reset_mask": ...}``).
        engine: ``native`` or ``mjx``.
        belief: Sensor that reads beliefs, with which observations then end (``envs.belief``); None: they hold
            none.

    Raises:
        RequestError: A value is invalid.

    Example:
        >>> import gymnasium, mjx_fit.envs
        >>> batch = gymnasium.make_vec("mjx_fit/Insertion-v0", num_envs=2)
        >>> observation, info = batch.reset(seed=0)
        >>> observation.shape
        (2, 27)
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        world: str | None = None,
        config: Config | None = None,
        reward: Reward = "dense",
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        engine: Engine = "native",
        belief: BeliefReading | None = None,
    ):
        require("num_envs", num_envs, 1, MOST_ENVS)
        if engine not in ENGINES:
            raise RequestError(f"engine: {shown(engine)} is invalid: expected one of {', '.join(ENGINES)}")
        if world is not None and config is not None:
            raise RequestError("world: it cannot be used beside config, which has a world of its own")
        self.config = read_config(world_file(world)) if config is None else config
        require_for_envs(self.config, reward)
        try:
            self._mode = AutoresetMode(autoreset_mode)
        except ValueError:
            modes = ", ".join(mode.value for mode in AutoresetMode)
            raise RequestError(
                f"autoreset_mode: {shown(autoreset_mode)} is invalid: expected one of {modes}"
            ) from None
        self.num_envs = num_envs
        self.metadata = {**self.metadata, "autoreset_mode": self._mode}
        box = gymnasium.spaces.Box
        reader = None if belief is None else BeliefReader(self.config, belief)
        seen = size(self.config) + (0 if reader is None else COMPONENTS)
        self.single_observation_space = box(-np.inf, np.inf, (seen,), np.float32)
        self.single_action_space = box(-1.0, 1.0, (width(self.config),), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._worlds = InsertionWorlds(self.config, num_envs, reward, engine, reader)
        self._over = np.zeros(num_envs, bool)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float[np.ndarray, "n k"], dict[str, Any]]:
        """Begin an episode in all worlds, or in those of ``options["reset_mask"]``.

        Args:
            seed: Seed of all episodes that follow; None: drawn from entropy.
            options: ``reset_mask``, a mask (n,), for ``Disabled`` resets.

        Raises:
            RequestError: An option is unknown, or the seed is invalid.
        """
        options = dict(options or {})
        mask = options.pop("reset_mask", None)
        if options:
            raise RequestError(f"options: {shown(next(iter(options)))} is unknown: expected reset_mask")
        if seed is not None and not isinstance(seed, int):
            raise RequestError(f"seed: {shown(seed)} is invalid: expected one integer for all worlds")
        if mask is not None:
            if seed is not None:
                raise RequestError("seed: it cannot be used with reset_mask: it is that of all episodes")
            if self._mode != AutoresetMode.DISABLED:
                raise RequestError(f"options: reset_mask cannot be used with {self._mode.value} resets")
            which = np.asarray(mask)
            if which.shape != (self.num_envs,) or which.dtype != bool:
                raise RequestError(
                    f"options: reset_mask: {which.dtype} {which.shape} is invalid: expected bool "
                    f"({self.num_envs},)"
                )
            self._worlds.begin(which, again=self._over)
            self._over &= ~which
            return self._worlds.observation(), {}
        seed = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else seed
        require_seed(seed)
        self._over[:] = False
        return self._worlds.begin_all(root_key(seed, "environment")), {}

    def step(
        self, actions: Float[np.ndarray, "n a"]
    ) -> tuple[Float[np.ndarray, "n k"], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Simulate an action of every world.

        Raises:
            RequestError: The actions have another shape or are not finite.

        Returns:
            Observations, rewards, terminated, truncated, and for worlds whose episode ends ``inserted`` and
            ``largest_n``, the largest force of the last action, N.
        """
        expected = (self.num_envs, width(self.config))
        try:
            actions = np.asarray(actions, np.float32)
        except (TypeError, ValueError):
            raise RequestError(f"actions: {shown(actions)} is invalid: expected numbers {expected}") from None
        if actions.shape != expected:
            raise RequestError(f"actions: {actions.shape} is invalid: expected {expected}")
        if not np.isfinite(actions).all():
            raise RequestError("actions: a value is not finite: expected numbers in [-1, 1]")
        waiting = self._over.copy()
        # A world that waits is at the start of an episode; its action neither moves nor presses.
        given = np.where(waiting[:, None], np.eye(1, expected[1], 2) * -1, actions)
        done = self._worlds.step(given)
        over = done.over & ~waiting
        info: dict[str, Any] = {}
        if over.any():
            info = {name: getattr(done, name) for name in _TOLD}
            info |= {f"_{name}": over for name in _TOLD}
        observation = self._begun_anew(done, over, waiting, info)
        ended, cut = (np.where(waiting, False, one) for one in (done.terminated, done.truncated))
        return observation, np.where(waiting, 0.0, done.reward), ended, cut, info

    def _begun_anew(
        self, done: Transition, over: np.ndarray, waiting: np.ndarray, info: dict[str, Any]
    ) -> Float[np.ndarray, "n k"]:
        """Begin the episodes that are due, and return the observations after the step."""
        # Worlds whose episode is over begin the next one at once: one that diverged cannot be stepped.
        if (over | waiting).any():
            self._worlds.begin(over | waiting, again=waiting)
        now = self._worlds.observation()
        if self._mode == AutoresetMode.SAME_STEP:
            if over.any():
                last = np.full(self.num_envs, None, object)
                for row in np.flatnonzero(over):
                    last[row] = done.observation[row]
                ends = {name: info[name] for name in (*_TOLD, *(f"_{name}" for name in _TOLD))}
                info |= {"final_obs": last, "_final_obs": over, "final_info": ends, "_final_info": over}
            return now
        if self._mode == AutoresetMode.NEXT_STEP:
            self._over = over
            return np.where(over[:, None], done.observation, now)
        self._over = waiting | over
        return np.where(self._over[:, None], done.observation, now)
