"""Worlds that a caller steps action by action, each begun anew on its own; in MuJoCo's C engine."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from mjx_fit.config.schema import Config
from mjx_fit.control.policies import PolicyInput
from mjx_fit.engines import attempt_rules
from mjx_fit.engines.native.block import Block
from mjx_fit.engines.native.controller import ROWS, Brain, padded, rows_for
from mjx_fit.engines.native.drive import driven
from mjx_fit.engines.native.models import Models
from mjx_fit.engines.policy_runner import Memory
from mjx_fit.engines.stepped import Stepped, from_outside, told
from mjx_fit.engines.threads import OneByOne, on_threads, parts_of, silence_mujoco
from mjx_fit.scene.build import simulation_scene
from mjx_fit.scene.placement import Setting
from mjx_fit.types import Attempt


class Worlds:
    """A fixed number of worlds, each in an attempt of its own.

    Example:
        >>> import jax, numpy as np, mjx_fit as mf
        >>> from mjx_fit.engines.native.worlds import Worlds
        >>> worlds = Worlds(mf.Config(), mf.draw_attempts(jax.random.key(0), 2), threads=1)
        >>> worlds.seen().contact.tolist()
        [False, False]
        >>> stepped = worlds.act(np.array([[0.0, 0.0, -0.004]] * 2))
        >>> stepped.verdict.over.tolist()
        [False, False]
    """

    def __init__(self, config: Config, attempts: Attempt, threads: int):
        """Begin attempts (n,), one in each world.

        Args:
            config: The configuration.
            attempts: First attempt of each world.
            threads: Number of host threads.
        """
        silence_mujoco()
        scene = simulation_scene(config.scene)
        brain = Brain(scene, config, from_outside(config))
        models, self._threads, self._compiling = Models(scene), threads, OneByOne()
        self._ids = parts_of(len(attempts.peg_type), threads, ROWS[-1])
        self._parts = [
            _Part(brain, models, jax.tree.map(lambda leaf, i=i: leaf[i], attempts)) for i in self._ids
        ]

    def seen(self) -> PolicyInput:
        """Return what is seen before the next action of each world, (n,), as NumPy arrays, in its frame."""
        return _joined([part.seen() for part in self._parts])

    def act(self, command: Float[np.ndarray, "n k"]) -> Stepped:
        """Simulate one action of every world under these commands (``stepped.from_outside``)."""
        done: dict[int, Stepped] = {}

        def work(number: int) -> None:
            ids = self._ids[number]
            with self._compiling.at_first(("act", rows_for(len(ids)))):
                done[number] = self._parts[number].act(command[ids])

        on_threads(self._threads, work, range(len(self._parts)))
        return _joined([done[number] for number in range(len(self._parts))])

    def restart(self, over: Bool[np.ndarray, "n"], attempts: Attempt) -> None:
        """Begin the attempts (n,) of the worlds that are over; the rest of the attempts is ignored."""

        def work(number: int) -> None:
            ids = self._ids[number]
            own = jax.tree.map(lambda leaf: leaf[ids], attempts)
            if over[ids].any():
                with self._compiling.at_first(("restart", rows_for(len(ids)))):
                    self._parts[number].restart(over[ids], own)

        on_threads(self._threads, work, range(len(self._parts)))


class _Part:
    """Worlds of one block."""

    def __init__(self, brain: Brain, models: Models, attempts: Attempt):
        self._brain, self._n = brain, len(attempts.peg_type)
        self._rows = np.arange(self._n)
        self._attempts = padded(attempts, self._rows)
        qpos = np.asarray(brain.start(attempts=self._attempts))[: self._n]
        self._setting = self._settings()
        here = jax.tree.map(lambda leaf: leaf[: self._n], self._setting)
        self._block = Block(models, brain.layout, attempts, here, qpos, len(self._attempts.peg_type))
        self._memory = self._begun()
        self._step = np.zeros(len(self._attempts.peg_type), np.int32)
        self._limited = np.zeros(self._n, np.int32)

    def seen(self) -> PolicyInput:
        horizon = self._brain.config.task.attempt_actions
        seen = self._brain.seen(self._memory, self._block.packed(), self._step, horizon)
        return jax.tree.map(lambda leaf: leaf[: self._n], seen)

    def act(self, command: Float[np.ndarray, "m k"]) -> Stepped:
        brain, block, horizon = self._brain, self._block, self._brain.config.task.attempt_actions
        memory = told(self._memory, padded(np.asarray(command, np.float32), self._rows))
        state, *acted = brain.act_at(memory, block.packed(), self._step, horizon)
        command_world, wanted, *_ = jax.tree.map(np.asarray, acted)
        goal = driven(brain, block, memory, wanted)
        felt = padded(block.wrench.swapaxes(0, 1), self._rows)
        self._memory = replace(
            memory, state=state, wrench_sensor=felt, command_world=command_world, goal=goal
        )
        self._step += 1
        return self._judged(command_world[: self._n])

    def _judged(self, command_world: Float[np.ndarray, "m K"]) -> Stepped:
        block, own = self._block, self._attempts
        physics, config = self._memory.physics, self._brain.config
        tip = self._brain.tip(block.packed(), physics)
        both = tip, self._brain.peg(tip, self._setting, physics)
        tip, peg = jax.tree.map(lambda leaf: np.asarray(leaf)[: self._n], both)
        hole, at_limit, limited = own.hole_pos_world[: self._n], block.at_limit(), self._limited
        verdict = attempt_rules.judge(peg, hole, block.finite(), at_limit, limited, config)
        self._limited = np.asarray(verdict.limited)
        row = attempt_rules.trace_row(tip, block.wrench.swapaxes(0, 1), command_world)
        return Stepped(row, peg, verdict, block.tare_sensor)

    def restart(self, over: Bool[np.ndarray, "m"], attempts: Attempt) -> None:
        rows, new = np.flatnonzero(over), padded(attempts, self._rows)
        all_over = padded(over, self._rows)
        self._attempts = _chosen(all_over, new, self._attempts)
        qpos = np.asarray(self._brain.start(attempts=self._attempts))
        self._setting = self._settings()
        begun, here = jax.tree.map(lambda leaf: leaf[rows], (self._attempts, self._setting))
        self._block.restart(rows, begun, here, qpos[rows])
        self._memory = _chosen(all_over, self._begun(), self._memory)
        self._step = np.where(all_over, 0, self._step)
        self._limited = np.where(over, 0, self._limited)

    def _settings(self) -> Setting:
        return self._brain.setting(self._attempts.hole_pos_world, self._attempts.physics)

    def _begun(self) -> Memory:
        tip = np.asarray(self._block.tip_pos_world, np.float32)
        at_rest = (padded(one, self._rows) for one in (self._block.tare_sensor, tip))
        return self._brain.begin(self._attempts, *at_rest)


def _chosen(over: Bool[np.ndarray, "rows"], new, old):
    """Select the new rows of a pytree where the old ones are over."""
    return jax.tree.map(partial(_where_rows, over), new, old)


def _where_rows(over: Bool[np.ndarray, "rows"], new, old):
    if jnp.issubdtype(new.dtype, jax.dtypes.prng_key):
        return jnp.where(over, new, old)
    return np.where(over.reshape(-1, *[1] * (new.ndim - 1)), np.asarray(new), np.asarray(old))


def _joined(parts: list):
    return jax.tree.map(lambda *leaves: _concatenated(leaves), *parts)


def _concatenated(leaves):
    if jnp.issubdtype(leaves[0].dtype, jax.dtypes.prng_key):
        return jnp.concatenate(leaves)
    return np.concatenate([np.asarray(leaf) for leaf in leaves])
