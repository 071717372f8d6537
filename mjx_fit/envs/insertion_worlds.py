"""Worlds of the environments: attempts of pegs at their own holes, stepped action by action."""

from dataclasses import dataclass
from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Key

from mjx_fit.config.schema import Config
from mjx_fit.data.schedule import draw_attempts
from mjx_fit.engines.mjx.stepped import MjxWorlds
from mjx_fit.engines.native.worlds import Worlds
from mjx_fit.envs.belief import BeliefReader
from mjx_fit.envs.observation import commanded, observed, width
from mjx_fit.envs.outcome import outcome, worth_at_start
from mjx_fit.envs.reward import Reward
from mjx_fit.types import Attempt
from mjx_fit.utils import granted_cpus
from mjx_fit.utils.errors import RequestError

Engine = Literal["native", "mjx"]
ENGINES: tuple[Engine, ...] = ("native", "mjx")


@dataclass(frozen=True)
class Transition:
    """What an action led to, in n worlds.

    Attributes:
        observation: Observation after the action, (n, k).
        reward: Its reward.
        terminated: Whether the peg is in, or the simulation diverged.
        truncated: Whether the time of the attempt is over.
        inserted: Whether the peg is in.
        largest_n: Largest contact force of the action, N; infinite in a simulation that diverged.
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
        config: The configuration.
        n: Number of worlds.
        kind: Reward.
        engine: Engine that simulates.
        reader: Reader of beliefs, which observations then end with; None: they hold none.
    """

    def __init__(
        self, config: Config, n: int, kind: Reward, engine: Engine, reader: BeliefReader | None = None
    ):
        self.config, self.n, self._engine, self._reader = config, n, engine, reader
        self._observe = jax.jit(jax.vmap(partial(observed, config=config)))
        self._judge = jax.jit(jax.vmap(partial(outcome, kind=kind, config=config)))
        self._worth = jax.jit(jax.vmap(partial(worth_at_start, config=config)))
        self._draw = partial(draw_attempts, policy="spiral", config=config)
        self._worlds: Worlds | MjxWorlds | None = None

    def begin_all(self, root: Key[jax.Array, ""]) -> Float[np.ndarray, "n k"]:
        """Begin the first episode of each world; return the observations.

        Args:
            root: Key of all episodes. Episode j of world i depends on it, on i, on n and on j alone.
        """
        self._root, self._episode = root, np.zeros(self.n, int)
        drawn = self._drawn()
        everywhere = np.ones(self.n, bool)
        if self._worlds is None:
            make = MjxWorlds if self._engine == "mjx" else Worlds
            self._worlds = make(self.config, drawn, granted_cpus.cpus())
        else:
            self._worlds.restart(everywhere, drawn)
        self._command = np.zeros((self.n, width(self.config)), np.float32)
        self._hole, self._length = np.zeros((self.n, 2), np.float32), np.zeros(self.n, int)
        self._value = np.zeros(self.n, np.float32)
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
        if self._observed is None:
            self._observed = np.array(self._observe(self._stepped().seen(), self._command), np.float32)
            if self._reader is not None:
                self._observed = np.concatenate([self._observed, self._reader.observed()], 1)
        return self._observed

    def step(self, action: Float[np.ndarray, "n a"]) -> Transition:
        """Simulate one action of every world."""
        worlds, before = self._stepped(), self.observation()
        self._command = np.array(commanded(jnp.asarray(action, jnp.float32)))
        stepped = worlds.act(self._command)
        if self._reader is not None:
            self._reader.add(stepped)
        judged = self._judge(stepped, self._hole, self._value)
        judged = jax.tree.map(np.asarray, judged)
        self._observed, self._value = None, judged.worth.copy()
        self._length += 1
        truncated = ~judged.terminated & (self._length >= self.config.task.attempt_actions)
        # A simulation that diverged has nothing to observe.
        self._observed = np.where(judged.valid[:, None], self.observation(), before)
        return Transition(
            self._observed, judged.reward, judged.terminated, truncated, judged.inserted, judged.largest_n
        )

    def _drawn(self) -> Attempt:
        # Even ids are pegs at their own holes, of all types in turn.
        return self._draw(self._root, 2 * jnp.asarray(np.arange(self.n) + self.n * self._episode))

    def _note_begun(self, which: Bool[np.ndarray, "n"], drawn: Attempt) -> None:
        self._hole[which] = np.asarray(drawn.hole_pos_world)[which]
        self._value[which] = np.asarray(self._worth(drawn))[which]
        self._command[which], self._length[which], self._observed = 0, 0, None
        if self._reader is not None:
            self._reader.begin(which, drawn)

    def _stepped(self) -> Worlds | MjxWorlds:
        if self._worlds is None:
            raise RequestError("reset: it has to come before the first step")
        return self._worlds
