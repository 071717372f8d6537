"""Control and policies of a block of worlds, jitted: what the native engine asks of JAX between two steps.

Every function is compiled for a few numbers of rows; a block is padded to the least of them that it fits.
"""

from functools import partial
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from mjx_fit.config.schema import Config
from mjx_fit.control import operational_space
from mjx_fit.control.kinematics import chain_of
from mjx_fit.control.policies import Policy
from mjx_fit.engines import attempt_rules, policy_runner
from mjx_fit.engines.attempt_rules import Tip
from mjx_fit.engines.native.block import Layout
from mjx_fit.engines.policy_runner import Memory
from mjx_fit.scene.build import Scene
from mjx_fit.types import Array

T = TypeVar("T")

CHUNK = 32
"""Rows that the controller computes at a time: larger intermediate results made a call several times slower.
Always so many also means the same bits for the torques, whatever the block."""

ROWS = (32, 64, 128, 256, 512)
"""Rows that the controller is compiled for: a block holds at most the last, and takes the least that it fits.
The larger the block, the less often a thread changes between physics and control, whose code and data push
each other out of its cache. What an action starts and ends with is computed for all rows, with the same bits
too (tests/test_engines.py)."""


class Brain:
    """The jitted functions.

    Attributes:
        config: The configuration.
        layout: How the inputs of the controller lie in a row of numbers.
        start: From attempts (rows,), the joint angles (rows, joints) at which they start, rad.
        begin: From attempts and what their sensors read in free space (rows, 6), the policy's memory.
        act: From that memory, packed inputs, the number of the action and the horizon: the policy's state,
            its command and the goal that it gives the tip, (rows, 3) each, m.
        torque: From packed inputs and goals, joint torques (rows, joints), N·m.
        tip: From packed inputs, the tips.
    """

    def __init__(self, scene: Scene, config: Config, policy: Policy):
        self.config, self.layout = config, Layout(scene)
        self._policy, self._robot = policy, scene.robot
        chain = chain_of(scene.models[0], scene.robot)
        self.start = jax.jit(partial(attempt_rules.start_qpos, chain, scene=config.scene))
        self.begin = jax.jit(jax.vmap(partial(policy_runner.begin, policy)))
        self.act = jax.jit(jax.vmap(self._act, (0, 0, None, None)), static_argnums=3)
        self.torque = jax.jit(self._torque)
        self.tip = jax.jit(jax.vmap(self._tip))

    def _torque(
        self, packed: Float[Array, "rows k"], goal_pos_world: Float[Array, "rows 3"]
    ) -> Float[Array, "rows joints"]:
        def chunk(part):
            rows, goal = part
            return operational_space.torque(
                self.layout.unpack(rows.T), goal.T, self.config.control, self._robot
            ).T

        chunks = (x.reshape(-1, CHUNK, x.shape[1]) for x in (packed, goal_pos_world))
        return jax.lax.map(chunk, tuple(chunks)).reshape(len(packed), -1)

    def _act(self, memory: Memory, packed: Float[Array, "k"], step, horizon: int):
        tip = self._tip(packed)
        state, command = policy_runner.act(self._policy, self.config.wrist, horizon, memory, tip, step)
        return state, command, tip.pos_world + command

    def _tip(self, packed: Float[Array, "k"]) -> Tip:
        return attempt_rules.tip_of(self.layout.unpack(packed))


def rows_for(n: int) -> int:
    """Rows of the controller for n worlds."""
    return next(rows for rows in ROWS if rows >= n)


def padded(tree: T, ids: Int[np.ndarray, "m"]) -> T:
    """The rows of a pytree with these ids, padded to as many as the controller takes."""
    rows = np.concatenate([ids, np.repeat(ids[-1:], rows_for(len(ids)) - len(ids))])

    def take(leaf):
        if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            data = jnp.asarray(np.asarray(jax.random.key_data(leaf))[rows])
            return jax.random.wrap_key_data(data, impl=jax.random.key_impl(leaf))
        return np.asarray(leaf)[rows]

    return jax.tree.map(take, tree)
