"""Gymnasium's environment of insertions in two worlds at once, as Stable-Baselines3 steps it."""

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from jaxtyping import Float
from stable_baselines3.common.vec_env import VecEnv

from mjx_fit.config.worlds import preset
from mjx_fit.envs import InsertionVectorEnv

WORLDS = ("home", "forge")


class TwoWorlds(VecEnv):
    """Half of the environments have the physics of `home`, half draw theirs from `forge`."""

    def __init__(self, per_world: int, seed: int):
        same = AutoresetMode.SAME_STEP
        self._halves = [
            InsertionVectorEnv(per_world, config=preset("gentle", world), autoreset_mode=same)
            for world in WORLDS
        ]
        self._root = seed
        one = self._halves[0]
        n = per_world * len(WORLDS)
        super().__init__(n, one.single_observation_space, one.single_action_space)
        self._length, self._return = np.zeros(n, int), np.zeros(n)

    def reset(self) -> Float[np.ndarray, "n k"]:
        self._length[:], self._return[:] = 0, 0
        begun = [half.reset(seed=self._root + i)[0] for i, half in enumerate(self._halves)]
        return np.concatenate(begun)

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        parts = np.split(self._actions, len(self._halves))
        done = [half.step(part) for half, part in zip(self._halves, parts, strict=True)]
        parts = [[one[0] for one in done], *([np.asarray(one[i]) for one in done] for i in (1, 2, 3))]
        seen, reward, ended, cut = map(np.concatenate, parts)
        self._length += 1
        self._return += reward
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(ended | cut):
            half, row = divmod(int(i), self.num_envs // len(self._halves))
            told = done[half][4]
            # An attempt whose time is over has failed: nothing is to be expected behind it.
            infos[i] = {
                "episode": {"r": self._return[i], "l": self._length[i], "t": 0.0},
                "inserted": bool(told["inserted"][row]),
            }
            self._length[i], self._return[i] = 0, 0
        return seen, reward.astype(np.float32), ended | cut, infos

    def close(self) -> None:
        pass

    def get_attr(self, attr_name: str, indices=None) -> list[Any]:
        return [getattr(self, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices=None) -> None:
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *method_args, indices=None, **method_kwargs) -> list[Any]:
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class, indices=None) -> list[bool]:
        return [False] * self.num_envs
