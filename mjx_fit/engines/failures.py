"""Worlds that were stopped, as they turned non-finite or left what is believed: reported, kept for replay.

``mjx_fit.engines.plausible`` says what is believed.
"""

import sys
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Bool, Int

from mjx_fit.config.schema import Config, config_from_yaml, config_to_yaml
from mjx_fit.control.policies import OWN, Policy
from mjx_fit.engines import failure_file
from mjx_fit.engines.interface import Engine
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.engines.plausible import reason
from mjx_fit.types import Attempt, Rollout
from mjx_fit.utils import files
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.filesystem import path_inside
from mjx_fit.utils.numerics import KEY_IMPL

_PLAIN = ("peg_type", "hole_type", "hole_pos_world", "estimate_world", "policy")
"""Fields of an attempt that are plain arrays."""

MOST_LINES = 10
"""Worlds of one batch that are reported by name; the others are counted."""


def report(
    rollouts: Rollout,
    attempts: Attempt,
    ids: Int[np.ndarray, "n"],
    horizon: int,
    config: Config,
    folder: Path,
) -> int:
    """Names the broken worlds of a batch on stderr and writes each into a file that ``replay`` reads.

    The first ``MOST_LINES`` are named with what went wrong, the others counted.

    Args:
        rollouts: What came of a batch (n,).
        attempts: What it was asked, with n rows or more.
        ids: Episode or trial ids of the batch.
        horizon: Actions that the policy planned for.
        config: The configuration.
        folder: Where the files go, ``broken-<id>.npz``; made if it is needed.

    Returns:
        How many there are.
    """
    broken = np.flatnonzero(~rollouts.truth.valid)
    for place, i in enumerate(broken):
        path = path_inside(folder.parent, folder.name) / f"broken-{ids[i]:08d}.npz"
        arrays = {
            "qpos": rollouts.truth.end_qpos[i],
            "qvel": rollouts.truth.end_qvel[i],
            "step": rollouts.felt.length[i] - 1,
            "horizon": horizon,
            "config": config_to_yaml(config),
            "key": jax.random.key_data(attempts.key[i]),
            **{name: np.asarray(getattr(attempts, name))[i] for name in _PLAIN},
        }
        files.replace_with(path, lambda temporary, arrays=arrays: _save(temporary, arrays))
        if place < MOST_LINES:
            _say(
                f"episode {ids[i]}: {reason(rollouts, int(i), config.scene)} in action {arrays['step']}; "
                f"it is left out, and its state before that action is in {path}"
            )
    if len(broken) > MOST_LINES:
        _say(f"{len(broken) - MOST_LINES} more episodes of this batch are left out likewise; see {folder}")
    return len(broken)


def kept_in(folder: Path) -> int:
    """Number of broken worlds that ``report`` has written into a folder."""
    return sum(1 for _ in folder.glob("broken-*.npz"))


def replay(path: Path, policy: Policy | None = None) -> Rollout:
    """Does the action that broke a world again, in the C engine, from the state before it.

    Args:
        path: A file that ``report`` wrote.
        policy: The engine's own policy, where it had one: the file does not hold it.

    Returns:
        A batch of one interaction with that action's row filled.

    Raises:
        RequestError: It is no such file, or its policy is missing.
    """
    kept = failure_file.read(path)
    if int(kept["policy"]) == OWN and policy is None:
        raise RequestError(f"replay: {path} comes from an engine with a policy of its own: give that policy")
    config = config_from_yaml(str(kept["config"]))
    key = jax.random.wrap_key_data(jax.numpy.asarray(kept["key"])[None], impl=KEY_IMPL)
    attempt = Attempt(key=key, **{name: kept[name][None] for name in _PLAIN})
    step, horizon = int(kept["step"]), int(kept["horizon"])
    return NativeEngine(config, 1, policy).act(attempt, kept["qpos"][None], kept["qvel"][None], step, horizon)


def as_run(attempts: Attempt, engine: Engine) -> Attempt:
    """The attempts with the policy that the engine follows, for those who keep them."""
    if engine.policy_name is None:
        return attempts
    return replace(attempts, policy=jax.numpy.full_like(attempts.policy, OWN))


class Reporting:
    """An engine that reports the broken worlds of all its batches, numbered one after the other.

    Args:
        engine: Runs the attempts.
        config: Its configuration.
        folder: Where the files go.
    """

    def __init__(self, engine: Engine, config: Config, folder: Path):
        self.name, self.policy_name = engine.name, engine.policy_name
        self._engine, self._config, self._folder = engine, config, folder
        self._seen = 0

    def run(
        self,
        attempts: Attempt,
        actions: int | None = None,
        active: Bool[np.ndarray, "n"] | None = None,
        horizon: int | None = None,
    ) -> Rollout:
        """See ``Engine.run``."""
        actions = self._config.task.attempt_actions if actions is None else actions
        rollouts = self._engine.run(attempts, actions, active, horizon)
        ids = self._seen + np.arange(len(rollouts.felt.length))
        report(rollouts, as_run(attempts, self._engine), ids, horizon or actions, self._config, self._folder)
        self._seen += len(ids)
        return rollouts


def _say(message: str) -> None:
    print(f"mjx-fit: {message}", file=sys.stderr)


def _save(path: Path, arrays: dict) -> None:
    with path.open("wb") as file:  # given a name, savez would add .npz to the temporary one
        np.savez(file, **arrays)
