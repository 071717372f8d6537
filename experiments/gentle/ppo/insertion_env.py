"""Batched environment of single attempts at matching holes, as Stable-Baselines3 steps it.

Half of the worlds have the physics of `home`, half are drawn from `forge`. The reward may use the truth; the
observation does not.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import gymnasium
import jax
import numpy as np
from jaxtyping import Float
from observation import commanded, observed
from stable_baselines3.common.vec_env import VecEnv

from mjx_fit.api import draw_attempts
from mjx_fit.config.schema import Config
from mjx_fit.config.worlds import preset
from mjx_fit.engines.native.worlds import Stepped, Worlds
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.types import Attempt
from mjx_fit.utils import granted_cpus

INSERTED, BROKEN, PER_ACTION, PER_NEWTON, FREE_N = 5.0, -2.0, -0.03, -0.02, 15.0
"""Rewards of an insertion, of a broken world, of each action, and of each newton of the largest force beyond
`FREE_N`. Besides, a centimetre towards the hole and a centimetre into it count 1 each."""


class InsertionEnv(VecEnv):
    """Attempts of at most ``task.attempt_actions`` actions; a world that is over begins a new one at once."""

    def __init__(self, per_world: int, seed: int):
        configs = [preset("gentle", world) for world in ("home", "forge")]
        self._halves = [_Half(config, per_world, seed + i) for i, config in enumerate(configs)]
        size = self._halves[0].observe().shape[1]
        box = gymnasium.spaces.Box
        super().__init__(
            2 * per_world, box(-np.inf, np.inf, (size,), np.float32), box(-1.0, 1.0, (3,), np.float32)
        )

    def reset(self) -> Float[np.ndarray, "n k"]:
        return np.concatenate([half.observe() for half in self._halves])

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = np.clip(actions, -1, 1)

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        parts = np.split(self._actions, len(self._halves))
        done = [half.step(part) for half, part in zip(self._halves, parts, strict=True)]
        seen, reward, over = (np.concatenate([one[i] for one in done]) for i in range(3))
        return seen, reward, over, [info for one in done for info in one[3]]

    def close(self) -> None:
        pass

    def get_attr(self, attr_name: str, indices=None) -> list[Any]:
        return [getattr(self, attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices=None) -> None:
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *method_args, indices=None, **method_kwargs) -> list[Any]:
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class, indices=None) -> list[bool]:
        return [False] * self.num_envs


class _Half:
    """Worlds of one configuration."""

    def __init__(self, config: Config, n: int, seed: int):
        self._config, self._n, self._key, self._round = config, n, jax.random.key(seed), 0
        first = self._draw()
        self._worlds = Worlds(config, first, granted_cpus.cpus())
        self._hole = np.array(first.hole_pos_world)
        self._observed = jax.jit(jax.vmap(partial(observed, config=config)))
        self._command = np.zeros((n, 3), np.float32)
        self._length = np.zeros(n, int)
        self._value = self._worth_of_starts(first)
        self._return = np.zeros(n)

    def observe(self) -> Float[np.ndarray, "n k"]:
        return np.asarray(self._observed(self._worlds.seen(), self._command))

    def step(self, action: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray, np.ndarray, list]:
        self._command = np.array(commanded(action), np.float32)
        stepped = self._worlds.act(self._command)
        self._length += 1
        reward, inserted = self._reward(stepped)
        over = np.asarray(stepped.verdict.over) | (self._length == self._config.task.attempt_actions)
        infos: list[dict[str, Any]] = [{} for _ in range(self._n)]
        for i in np.flatnonzero(over):
            infos[i]["episode"] = {"r": self._return[i], "l": self._length[i], "t": 0.0}
            infos[i]["inserted"] = bool(inserted[i])
        if over.any():
            self._restart(over)
        return self.observe(), reward.astype(np.float32), over, infos

    def _reward(self, stepped: Stepped) -> tuple[np.ndarray, np.ndarray]:
        inserted, valid = (np.asarray(getattr(stepped.verdict, name)) for name in ("inserted", "valid"))
        value = np.where(valid, self._worth(np.asarray(stepped.tip.pos_world)), self._value)
        largest = np.linalg.norm(stepped.wrench_sensor[..., :3], axis=-1).max(1)
        reward = value - self._value + PER_ACTION + PER_NEWTON * np.clip(largest - FREE_N, 0, 50)
        reward = np.where(valid, reward + INSERTED * inserted, BROKEN)
        self._value, self._return = value, self._return + reward
        return reward, inserted

    def _restart(self, over: np.ndarray) -> None:
        drawn = self._draw()
        self._hole[over] = np.asarray(drawn.hole_pos_world)[over]
        self._worlds.restart(over, drawn)
        self._command[over] = 0
        self._length[over], self._return[over] = 0, 0
        self._value[over] = self._worth_of_starts(drawn)[over]

    def _draw(self) -> Attempt:
        key, self._round = jax.random.fold_in(self._key, self._round), self._round + 1
        drawn = draw_attempts(key, self._n, config=self._config)
        return replace(drawn, hole_type=drawn.peg_type)

    def _worth_of_starts(self, attempts: Attempt) -> Float[np.ndarray, "n"]:
        start = np.asarray(attempts.estimate_world)
        return self._worth(np.pad(start, ((0, 0), (0, 1)), constant_values=plate_top_m(self._config.scene)))

    def _worth(self, tip_pos_world: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """Return the potential of places: centimetres to the hole, negative, and into it."""
        away = np.linalg.norm(tip_pos_world[:, :2] - self._hole, axis=1)
        below = plate_top_m(self._config.scene) - tip_pos_world[:, 2]
        return -100 * away + 100 * np.clip(below, 0, self._config.task.insertion_depth_m)
