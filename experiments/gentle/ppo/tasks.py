"""Tasks for reinforcement: Gymnasium's environment of insertions, as Stable-Baselines3 steps it."""

from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from jaxtyping import Float
from stable_baselines3.common.vec_env import VecEnv

from mjx_fit.config.schema import Config
from mjx_fit.config.worlds import preset
from mjx_fit.envs import InsertionVectorEnv


def configs_of(task: str) -> list[Config]:
    """Return the configurations of a task.

    `search` has the physics of `home` in one half of its environments, and draws that of the other from
    `forge`. `known` is at home, its detections are exact, and an attempt lasts 2 s: of pegs whose policy
    acts at random 15 % are in by then, and 42 % in 10 s.
    """
    if task == "known":
        home = preset("gentle", "home")
        exact = replace(home.detector, half_width_m=0.0)
        return [replace(home, detector=exact, task=replace(home.task, attempt_actions=20))]
    return [preset("gentle", world) for world in ("home", "forge")]


class Insertions(VecEnv):
    """N environments, of each of some configurations as many as of any other."""

    def __init__(self, n: int, configs: list[Config], seed: int):
        same = AutoresetMode.SAME_STEP
        self._parts = [
            InsertionVectorEnv(n // len(configs), config=config, autoreset_mode=same) for config in configs
        ]
        self._root = seed
        one = self._parts[0]
        super().__init__(n, one.single_observation_space, one.single_action_space)
        self._length, self._return = np.zeros(n, int), np.zeros(n)

    def reset(self) -> Float[np.ndarray, "n k"]:
        self._length[:], self._return[:] = 0, 0
        begun = [part.reset(seed=self._root + i)[0] for i, part in enumerate(self._parts)]
        return np.concatenate(begun)

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        actions = np.split(self._actions, len(self._parts))
        done = [part.step(own) for part, own in zip(self._parts, actions, strict=True)]
        parts = [[one[0] for one in done], *([np.asarray(one[i]) for one in done] for i in (1, 2, 3))]
        seen, reward, ended, cut = map(np.concatenate, parts)
        self._length += 1
        self._return += reward
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(ended | cut):
            part, row = divmod(int(i), self.num_envs // len(self._parts))
            told = done[part][4]
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
