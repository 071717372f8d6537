"""Report diverged simulations and save them for replay.

A simulation counts as diverged if it turned non-finite or implausible, by the bounds of
``mjx_fit.engines.plausible``.
"""

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Int

from mjx_fit.config.quantities import QUANTITIES
from mjx_fit.config.schema import Config, config_from_yaml, config_to_yaml
from mjx_fit.control import goals
from mjx_fit.control.goals import Goal
from mjx_fit.control.policies import OWN, Policy
from mjx_fit.engines import failure_file
from mjx_fit.engines.attempt_rules import as_judged
from mjx_fit.engines.failure_file import GOALS
from mjx_fit.engines.interface import Engine
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.engines.plausible import reason
from mjx_fit.sensors.pose import rotation_from_down, start_of
from mjx_fit.types import Attempt, Rollout
from mjx_fit.types.physics import Physics, drawn
from mjx_fit.utils import files
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.filesystem import path_inside
from mjx_fit.utils.numerics import KEY_IMPL

_PLAIN = ("peg_type", "hole_type", "hole_pos_world", "estimate_world", "policy")
"""Fields of an attempt that are plain arrays."""

MOST_LINES = 10
"""Maximum number of worlds per batch that are reported one by one; the others are only counted."""


def report(
    rollouts: Rollout,
    attempts: Attempt,
    ids: Int[np.ndarray, "n"],
    horizon: int,
    config: Config,
    folder: Path,
) -> int:
    """Report the diverged simulations of a batch on stderr and save each to a file that ``replay`` reads.

    The first ``MOST_LINES`` are listed with the reason, the others only counted.

    Args:
        rollouts: Rollouts of a batch (n,).
        attempts: Attempts of the batch, with n rows or more.
        ids: Episode or trial ids of the batch.
        horizon: Number of actions that the policy planned for.
        config: The configuration.
        folder: Folder of the files ``broken-<id>.npz``; created if needed.

    Returns:
        Number of diverged simulations.
    """
    broken = np.flatnonzero(~rollouts.truth.valid)
    if not len(broken):
        return 0
    before, judged = goals_before(rollouts, config), as_judged(rollouts[broken], config)
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
            **{f"physics_{name}": np.asarray(leaf)[i] for name, leaf in drawn(attempts.physics).items()},
            **{f"goal_{name}": leaf[i] for name, leaf in vars(before).items()},
        }
        files.replace_with(path, lambda temporary, arrays=arrays: _save(temporary, arrays))
        if place < MOST_LINES:
            _say(
                f"episode {ids[i]}: {reason(judged, place, config.scene)} in action {arrays['step']}; "
                f"it is left out; its state before that action is in {path}"
            )
    if len(broken) > MOST_LINES:
        _say(f"{len(broken) - MOST_LINES} more episodes of this batch are left out, too; see {folder}")
    return len(broken)


def goals_before(rollouts: Rollout, config: Config) -> Goal:
    """Reconstruct the controller's goals before the last actions of all attempts, NumPy arrays (n, k)."""
    felt = rollouts.felt
    start = start_of(felt, config)
    earlier = np.maximum(np.asarray(felt.length) - 1, 0)
    command, turn = felt.trace.action_world, felt.trace.turn_world
    command = command if turn is None else np.concatenate([command, turn], -1)
    turned = None if turn is None else rotation_from_down(start.quat_world)
    begin = goals.at_rest(start.pos_world, config.control, turned)
    tips = np.concatenate([np.asarray(start.pos_world)[:, None], felt.trace.tip_pos_world], 1)[:, :-1]
    wanted = goals.commanded(tips, command, config.control)
    done = _after_actions(begin, wanted, earlier, config.control, rollouts.truth.physics)
    return jax.tree.map(np.asarray, done)


@partial(jax.jit, static_argnames="control")
def _after_actions(begin: Goal, wanted_world, count, control, physics: Physics) -> Goal:
    def one(goal: Goal, wanted, number, own: Physics) -> Goal:
        return goals.after_actions(goal, wanted, number, control, own)

    return jax.vmap(one)(begin, wanted_world, count, physics)


def kept_in(folder: Path) -> int:
    """Count the diverged simulations that ``report`` has saved in a folder."""
    return sum(1 for _ in folder.glob("broken-*.npz"))


def replay(path: Path, policy: Policy | None = None) -> Rollout:
    """Replay the action that made a simulation diverge, in the C engine, from the state before it.

    Args:
        path: File from ``report``.
        policy: The custom policy of the engine, if it had one; the file does not contain it.

    Returns:
        A batch of one rollout, with only the row of that action filled.

    Raises:
        RequestError: The file is not from ``report``, or its policy is missing.
    """
    kept = failure_file.read(path)
    if int(kept["policy"]) == OWN and policy is None:
        raise RequestError(f"replay: {path} needs the custom policy of its engine: pass it as policy")
    config = config_from_yaml(str(kept["config"]))
    key = jax.random.wrap_key_data(jnp.asarray(kept["key"])[None], impl=KEY_IMPL)
    own = {name: kept[f"physics_{name}"][None] for name in QUANTITIES if f"physics_{name}" in kept}
    plain: dict[str, Any] = {name: kept[name][None] for name in _PLAIN}
    attempt = Attempt(key=key, physics=Physics(**own), **plain)
    step, horizon = int(kept["step"]), int(kept["horizon"])
    goal = None  # older versions did not keep it
    if f"goal_{GOALS[0]}" in kept:
        goal = Goal(**{name: kept[f"goal_{name}"][None] for name in GOALS})
    engine = NativeEngine(config, 1, policy)
    return engine.act(attempt, kept["qpos"][None], kept["qvel"][None], step, horizon, goal)


def as_run(attempts: Attempt, engine: Engine) -> Attempt:
    """Return the attempts with the index of the policy that the engine follows, to be stored."""
    if engine.policy_name is None:
        return attempts
    return replace(attempts, policy=jnp.full_like(attempts.policy, OWN))


class Reporting:
    """Engine wrapper that reports the diverged simulations of all batches, numbered consecutively.

    Args:
        engine: Engine that runs the attempts.
        config: Configuration of the engine.
        folder: Folder of the files.
    """

    def __init__(self, engine: Engine, config: Config, folder: Path):
        self.name, self.policy_name, self.turns = engine.name, engine.policy_name, engine.turns
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
    with path.open("wb") as file:  # with a name instead, savez would append .npz to it
        np.savez(file, **arrays)
