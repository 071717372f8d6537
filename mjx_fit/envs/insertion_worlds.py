"""Worlds of the environments: attempts of pegs at their own holes, stepped action by action."""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Key

from mjx_fit.config.schema import Config
from mjx_fit.data.schedule import draw_attempts
from mjx_fit.engines.native.worlds import Stepped, Worlds
from mjx_fit.envs import reward
from mjx_fit.envs.observation import commanded, observed
from mjx_fit.envs.reward import Reward
from mjx_fit.filters.frame import is_world
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.types import Attempt
from mjx_fit.utils import granted_cpus
from mjx_fit.utils.errors import RequestError


@dataclass(frozen=True)
class Transition:
    """What an action led to, in n worlds.

    Attributes:
        observation: Observation after the action, (n, k).
        reward: Its reward.
        terminated: Whether the peg is in, or the simulation diverged.
        truncated: Whether the time of the attempt is over.
        inserted: Whether the peg is in.
        largest_n: Largest contact force of the action, N.
    """

    observation: Float[np.ndarray, "n k"]
    reward: Float[np.ndarray, "n"]
    terminated: Bool[np.ndarray, "n"]
    truncated: Bool[np.ndarray, "n"]
    inserted: Bool[np.ndarray, "n"]
    largest_n: Float[np.ndarray, "n"]

    @property
    def over(self) -> Bool[np.ndarray, "n"]:
        """Whether the episode ends with the action."""
        return self.terminated | self.truncated


class InsertionWorlds:
    """Episodes in n worlds; the caller says when each begins.

    Args:
        config: The configuration; beliefs are about x and y alone.
        n: Number of worlds.
        kind: Reward.

    Raises:
        RequestError: The configuration believes other coordinates than x and y, its tools give way, or
            its pegs slip.
    """

    def __init__(self, config: Config, n: int, kind: Reward):
        if not is_world(config.filter.coordinates):
            names = ", ".join(config.filter.coordinates)
            raise RequestError(f"config: filter.coordinates: [{names}] is invalid: environments have [x, y]")
        for name, value in (
            ("control.tilt_radps", config.control.tilt_radps),
            ("placement.grip_n", config.placement.grip_n),
        ):
            if value:
                raise RequestError(f"config: {name}: {value:g} is invalid: environments have 0")
        self.config, self.n, self._kind = config, n, kind
        self._observe = jax.jit(jax.vmap(partial(observed, config=config)))
        self._draw = partial(draw_attempts, policy="spiral", config=config)
        self._worlds: Worlds | None = None

    def begin_all(self, root: Key[jax.Array, ""]) -> Float[np.ndarray, "n k"]:
        """Begin the first episode of each world; return the observations.

        Args:
            root: Key of all episodes. Episode j of world i depends on it, on i, on n and on j alone.
        """
        self._root, self._episode = root, np.zeros(self.n, int)
        drawn = self._drawn()
        everywhere = np.ones(self.n, bool)
        if self._worlds is None:
            self._worlds = Worlds(self.config, drawn, granted_cpus.cpus())
        else:
            self._worlds.restart(everywhere, drawn)
        self._command, self._hole = np.zeros((self.n, 3), np.float32), np.zeros((self.n, 2))
        self._length, self._value = np.zeros(self.n, int), np.zeros(self.n)
        self._note_begun(everywhere, drawn)
        return self.observation()

    def begin(self, which: Bool[np.ndarray, "n"], again: Bool[np.ndarray, "n"]) -> None:
        """Begin the next episode of some worlds, or the same one again."""
        worlds = self._stepped()
        self._episode += which & ~again
        drawn = self._drawn()
        worlds.restart(which, drawn)
        self._note_begun(which, drawn)

    def observation(self) -> Float[np.ndarray, "n k"]:
        """Return what is observed now, (n, k)."""
        return np.asarray(self._observe(self._stepped().seen(), self._command), np.float32)

    def step(self, action: Float[np.ndarray, "n 3"]) -> Transition:
        """Simulate one action of every world."""
        worlds, before = self._stepped(), self.observation()
        self._command = np.array(commanded(jnp.asarray(action, jnp.float32)))
        stepped = worlds.act(self._command)
        self._length += 1
        inserted, valid = (np.asarray(getattr(stepped.verdict, name)) for name in ("inserted", "valid"))
        largest = np.linalg.norm(stepped.wrench_sensor[..., :3], axis=-1).max(1)
        terminated = np.asarray(stepped.verdict.over)
        truncated = ~terminated & (self._length >= self.config.task.attempt_actions)
        earned = self._reward(stepped, largest, inserted, valid)
        # A simulation that diverged has nothing to observe.
        seen = np.where(valid[:, None], self.observation(), before)
        return Transition(seen, earned, terminated, truncated, inserted, np.where(valid, largest, np.inf))

    def _reward(
        self,
        stepped: Stepped,
        largest_n: Float[np.ndarray, "n"],
        inserted: Bool[np.ndarray, "n"],
        valid: Bool[np.ndarray, "n"],
    ) -> Float[np.ndarray, "n"]:
        if self._kind == "sparse":
            return inserted.astype(float)
        tip = np.where(valid[:, None], stepped.tip.pos_world, 0.0)
        value = np.where(valid, reward.worth(tip, self._hole, self.config), self._value)
        gain, self._value = value - self._value, value
        return reward.dense(gain, largest_n, inserted, valid)

    def _drawn(self) -> Attempt:
        # Even ids are pegs at their own holes, of all types in turn.
        return self._draw(self._root, 2 * jnp.asarray(np.arange(self.n) + self.n * self._episode))

    def _note_begun(self, which: Bool[np.ndarray, "n"], drawn: Attempt) -> None:
        start = np.asarray(drawn.estimate_world)
        above = np.column_stack([start, np.full(self.n, plate_top_m(self.config.scene))])
        self._hole[which] = np.asarray(drawn.hole_pos_world)[which]
        self._value[which] = reward.worth(above, self._hole, self.config)[which]
        self._command[which], self._length[which] = 0, 0

    def _stepped(self) -> Worlds:
        if self._worlds is None:
            raise RequestError("reset: it has to come before the first step")
        return self._worlds
