"""Control and policies for a block of worlds: jitted functions that the native engine calls between steps.

Every function is compiled for a few numbers of rows; a block is padded to the smallest one that fits.
"""

from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from mjx_fit.config.schema import Config
from mjx_fit.control import operational_space, policies
from mjx_fit.control.framed import as_seen
from mjx_fit.control.goals import commanded
from mjx_fit.control.kinematics import chain_of
from mjx_fit.control.policies import Policy, PolicyInput
from mjx_fit.engines import attempt_rules, policy_runner
from mjx_fit.engines.attempt_rules import Tip
from mjx_fit.engines.native.block import Layout
from mjx_fit.engines.policy_runner import Memory
from mjx_fit.scene.build import Scene
from mjx_fit.scene.placement import Setting, setting_of
from mjx_fit.scene.slip import slipped
from mjx_fit.types import Array, Attempt
from mjx_fit.types.physics import Physics

T = TypeVar("T")

CHUNK = 32
"""Number of rows that the controller computes at a time.

Larger intermediate results slow a call down several times. A fixed number also makes the torques
bit-identical for any block size.
"""

ROWS = (32, 64)
"""Numbers of rows that the controller is compiled for; a block uses the smallest one that fits.

A block holds at most as many worlds as the last one. Their data, and models of their own, then stay in the
thread's cache between steps: blocks of 512 run at 0.74 of the speed, and at 0.56 where each world has a model
of its own. Smaller blocks pay more for calls of the controller: those of 32 run at 0.89 (512 spirals of 100
actions on 2 cores of an AMD EPYC, 2026-11-27). The start and the end of an action are computed for all rows,
also with bit-identical results (tests/engines/test_engines.py).
"""


class Brain:
    """Jitted functions for control and policy.

    Attributes:
        config: The configuration.
        policy: The policy.
        layout: Layout of the controller's inputs in a row.
        start: Function of attempts (rows,): joint angles at the start (rows, joints), rad.
        begin: Function of attempts and F/T sensor readings in free space (rows, 6): the policy's memory.
        act: Function of that memory, packed inputs, index of the action and horizon: the policy's state, its
            command and the resulting goal of the TCP, (rows, k) each, m and rad; what it reports, and whether
            it gives up.
        seen: Function of the memory, packed inputs, index of each row's action and horizon: what the
            policy sees, in the frame of its estimate.
        act_at: The same as ``act``, with an index of the action for each row.
        torque: Function of packed inputs, goals and physics: joint torques (rows, joints), N·m.
        tip: Function of packed inputs and physics: the TCP states.
        setting: Function of the centres of holes and physics: the settings.
        slip: Function of the memory after an action: the physics, with the pegs as they have slipped.
        peg: Function of TCP states, settings and physics: the pegs (``attempt_rules.peg_of``).
        end: Function of the memory, packed inputs, settings and the number of actions made: the TCP states,
            the pegs, and whether the robot measures an insertion.
    """

    def __init__(self, scene: Scene, config: Config, policy: Policy):
        self.config, self.layout = config, Layout(scene)
        self.policy, self._robot = policy, scene.robot
        chain = chain_of(scene.models[0], scene.robot)
        self.start = jax.jit(partial(attempt_rules.start_qpos, chain, config=config))
        self.begin = jax.jit(jax.vmap(partial(policy_runner.begin, policy, config)))
        self.act = jax.jit(jax.vmap(self._act, (0, 0, None, None)), static_argnums=3)
        self.torque = jax.jit(self._torque)
        self.seen = jax.jit(jax.vmap(self._seen, (0, 0, 0, None)), static_argnums=3)
        self.act_at = jax.jit(jax.vmap(self._act, (0, 0, 0, None)), static_argnums=3)
        self.tip = jax.jit(jax.vmap(self._tip))
        self.setting = jax.jit(partial(setting_of, config=config))
        self.slip = jax.jit(jax.vmap(self._slip))
        self.peg = jax.jit(jax.vmap(partial(attempt_rules.peg_of, config=config)))
        self.end = jax.jit(jax.vmap(self._end, (0, 0, 0, None)))

    def no_report(self, attempts: Attempt, actions: int) -> Any:
        """Allocate what the policy reports about attempts (n,) after each action; None if nothing."""

        def told(attempt: Attempt) -> Any:
            start = policies.start_of(attempt)
            return policy_runner.reported(self.policy, self.policy.init(start, attempt.key))

        shapes = jax.eval_shape(jax.vmap(told), attempts)
        return jax.tree.map(
            lambda leaf: np.zeros((leaf.shape[0], actions, *leaf.shape[1:]), leaf.dtype), shapes
        )

    def _torque(
        self, packed: Float[Array, "rows k"], goal_world: Float[Array, "rows k"], physics: Physics
    ) -> Float[Array, "rows joints"]:
        def chunk(part):
            rows, goal, own = part
            gains = operational_space.gains_of(self.config, own)
            return operational_space.torque(self.layout.unpack(rows.T), goal.T, gains, self._robot).T

        def chunks(x):
            return x.reshape(-1, CHUNK, *x.shape[1:])

        parts = jax.tree.map(chunks, (packed, goal_world, physics))
        return jax.lax.map(chunk, parts).reshape(len(packed), -1)

    def _act(self, memory: Memory, packed: Float[Array, "k"], step, horizon: int):
        tip = self._tip(packed, memory.physics)
        state, command = policy_runner.act(self.policy, self.config, horizon, memory, tip, step)
        told, ends = policy_runner.reported(self.policy, state), policy_runner.gives_up(self.policy, state)
        return state, command, commanded(tip.pos_world, command, self.config.control), told, ends

    def _seen(self, memory: Memory, packed: Float[Array, "k"], step, horizon: int) -> PolicyInput:
        tip = self._tip(packed, memory.physics)
        seen = policy_runner.seen(self.policy.reads, self.config, horizon, memory, tip, step)
        return as_seen(seen, self.config)

    def _end(
        self, memory: Memory, packed: Float[Array, "k"], setting: Setting, step
    ) -> tuple[Tip, Tip, Bool[Array, ""] | None]:
        tip = self._tip(packed, memory.physics)
        peg = attempt_rules.peg_of(tip, setting, memory.physics, self.config)
        return tip, peg, policy_runner.measures_insertion(memory, tip, step, self.config)

    def _slip(self, memory: Memory) -> Physics:
        return slipped(memory.physics, memory.wrench_sensor, memory.tare_sensor, self.config)

    def _tip(self, packed: Float[Array, "k"], physics: Physics) -> Tip:
        return attempt_rules.tip_of(self.layout.unpack(packed), physics, self.config)


def rows_for(n: int) -> int:
    """Return the number of controller rows for n worlds."""
    return next(rows for rows in ROWS if rows >= n)


def padded(tree: T, ids: Int[np.ndarray, "m"]) -> T:
    """Select the rows of a pytree with these ids, padded to the number of controller rows."""
    rows = np.concatenate([ids, np.repeat(ids[-1:], rows_for(len(ids)) - len(ids))])

    def take(leaf):
        if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            data = jnp.asarray(np.asarray(jax.random.key_data(leaf))[rows])
            return jax.random.wrap_key_data(data, impl=jax.random.key_impl(leaf))
        return np.asarray(leaf)[rows]

    return jax.tree.map(take, tree)
