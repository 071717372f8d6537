"""Worlds in MJX that a caller steps action by action: pure functions, and a batch on host threads."""

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from mjx_fit.config.schema import Config
from mjx_fit.control.framed import as_seen
from mjx_fit.control.kinematics import Chain, chain_of
from mjx_fit.control.policies import PolicyInput
from mjx_fit.engines import attempt_rules, policy_runner
from mjx_fit.engines.attempt_rules import Verdict
from mjx_fit.engines.mjx.compiler import compiler_options
from mjx_fit.engines.mjx.engine import rows_of
from mjx_fit.engines.mjx.step import Models, WorldModel, arm_state
from mjx_fit.engines.mjx.world import Acted, World, WorldState
from mjx_fit.engines.stepped import Stepped, from_outside, told
from mjx_fit.engines.threads import on_threads, silence_mujoco
from mjx_fit.scene.build import pair_index, simulation_scene
from mjx_fit.scene.placement import setting_of
from mjx_fit.types import Array, Attempt, pytree


@pytree
class Ongoing:
    """One attempt between two actions.

    Attributes:
        attempt: The attempt.
        world: State of its world.
        step: Number of actions made.
    """

    attempt: Attempt
    world: WorldState
    step: Int[Array, ""]


@dataclass(frozen=True)
class SteppedWorld:
    """Pure functions of one world, for ``jax.vmap`` and ``jax.jit``; pegs do not slip in the hand.

    Attributes:
        config: The configuration.
        models: Models of all pairs of peg and hole.
        chain: Kinematics of the arm.
        world: The world.
    """

    config: Config
    models: Models
    chain: Chain
    world: World

    @classmethod
    def of(cls, config: Config) -> "SteppedWorld":
        """Compile the scene of a configuration."""
        silence_mujoco()
        scene = simulation_scene(config.scene)
        world = World(config, scene, from_outside(config))
        return cls(config, Models.of(scene), chain_of(scene.models[0], scene.robot), world)

    def begin(self, attempt: Attempt) -> Ongoing:
        """Begin an attempt at rest above its estimate."""
        with jax.default_matmul_precision("highest"):
            qpos = attempt_rules.start_qpos(self.chain, _batched(attempt), self.config)[0]
            world = self.world.begin(self._model(attempt), qpos, attempt, jnp.ones((), bool))
        return Ongoing(attempt, world, jnp.int32(0))

    def seen(self, now: Ongoing) -> PolicyInput:
        """Return what is seen before the next action, in the frame of the estimate."""
        memory = now.world.memory
        horizon = self.config.task.attempt_actions
        with jax.default_matmul_precision("highest"):
            arm = arm_state(self._model(now.attempt), now.world.data, self.world.scene)
            tip = attempt_rules.tip_of(arm, memory.physics, self.config)
            seen = policy_runner.seen(False, self.config, horizon, memory, tip, now.step)
            return as_seen(seen, self.config)

    def act(self, now: Ongoing, command: Float[Array, "k"]) -> tuple[Ongoing, Stepped]:
        """Simulate an action under a command (``stepped.from_outside``)."""
        world = replace(now.world, memory=told(now.world.memory, command))
        horizon = self.config.task.attempt_actions
        # Matrix products in lower precision (TF32 on some accelerators) break the constraint solver.
        with jax.default_matmul_precision("highest"):
            world, acted = self.world.act(self._model(now.attempt), now.attempt, world, now.step, horizon)
        # The caller decides when an attempt is over.
        world = replace(world, running=jnp.ones_like(world.running))
        return Ongoing(now.attempt, world, now.step + 1), _stepped(world, acted)

    def _model(self, attempt: Attempt) -> WorldModel:
        pair = pair_index(attempt.peg_type, attempt.hole_type, self.world.scene.n_types)
        model, axes = self.models.of_worlds(pair[None], _batched(attempt.physics))
        model = jax.tree.map(
            lambda axis, leaf: leaf if axis is None else leaf[0], axes, model, is_leaf=lambda x: x is None
        )
        return model._replace(setting=setting_of(attempt.hole_pos_world, attempt.physics, self.config))


class MjxWorlds:
    """A fixed number of worlds, each in an attempt of its own; see ``engines.native.worlds.Worlds``."""

    def __init__(self, config: Config, attempts: Attempt, threads: int):
        """Begin attempts (n,), one in each world, on this number of host threads."""
        self._one = SteppedWorld.of(config)
        n = len(attempts.peg_type)
        self._threads = threads if jax.default_backend() == "cpu" else 1
        # Parts are those of the engine: their size depends on n alone, since arithmetic depends on it.
        rows, self._n = rows_of(n), n
        self._ids = [np.minimum(np.arange(first, first + rows), n - 1) for first in range(0, n, rows)]
        jit = partial(jax.jit, compiler_options=compiler_options())
        self._seen, self._act = jit(jax.vmap(self._one.seen)), jit(jax.vmap(self._one.act))
        self._restart = jit(jax.vmap(self._restarted))
        begin = jit(jax.vmap(self._one.begin))
        self._parts = [begin(jax.tree.map(lambda leaf, i=i: leaf[i], attempts)) for i in self._ids]

    def seen(self) -> PolicyInput:
        """Return what is seen before the next action of each world, (n,), in its frame."""
        seen = _joined([self._seen(part) for part in self._parts])
        return jax.tree.map(lambda leaf: leaf[: self._n], seen)

    def act(self, command: Float[np.ndarray, "n k"]) -> Stepped:
        """Simulate one action of every world under these commands (``stepped.from_outside``)."""
        command = np.asarray(command, np.float32)
        done: dict[int, Stepped] = {}

        def work(number: int) -> None:
            self._parts[number], stepped = self._act(self._parts[number], command[self._ids[number]])
            done[number] = jax.tree.map(np.asarray, stepped)

        on_threads(self._threads, work, range(len(self._parts)))
        parts = [done[number] for number in range(len(self._parts))]
        return jax.tree.map(lambda *leaves: np.concatenate(leaves)[: self._n], *parts)

    def restart(self, over: Bool[np.ndarray, "n"], attempts: Attempt) -> None:
        """Begin the attempts (n,) of the worlds that are over; the rest of the attempts is ignored."""
        for number, ids in enumerate(self._ids):
            if over[ids].any():
                own = jax.tree.map(lambda leaf, ids=ids: leaf[ids], attempts)
                self._parts[number] = self._restart(self._parts[number], over[ids], own)

    def _restarted(self, now: Ongoing, over: Bool[Array, ""], attempt: Attempt) -> Ongoing:
        return jax.tree.map(partial(jnp.where, over), self._one.begin(attempt), now)


def _stepped(world: WorldState, acted: Acted) -> Stepped:
    """Return what the caller of an action is told."""
    verdict = Verdict(acted.valid, acted.inserted, world.limited)
    assert acted.peg is not None
    return Stepped(acted.row, acted.peg, verdict, world.memory.tare_sensor)


def _batched(tree):
    return jax.tree.map(lambda leaf: leaf[None], tree)


def _joined(parts: list):
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)
