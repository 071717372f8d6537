"""Contenders of the benchmark: each function prepares one way to simulate and returns a callable to time."""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Float
from mujoco.batch import Batch

from mjx_fit.cli.bench.peers import load_peer
from mjx_fit.config.schema import Config
from mjx_fit.control.kinematics import chain_of
from mjx_fit.data.schedule import draw_attempts
from mjx_fit.engines.attempt_rules import start_qpos
from mjx_fit.engines.mjx.compiler import compiler_options
from mjx_fit.engines.mjx.engine import MOST_ROWS
from mjx_fit.engines.mjx.step import Models, advance, placed
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.engines.select import make_engine
from mjx_fit.engines.threads import on_threads, parts_of
from mjx_fit.scene.build import pair_index
from mjx_fit.scene.robot import PANDA
from mjx_fit.types import Attempt
from mjx_fit.utils import granted_cpus, numerics
from mjx_fit.utils.rates import SUBSTEPS

THREADS = granted_cpus.cpus()

Run = Callable[[], int]
"""Simulates once and returns the number of torques, each held for 2 ms, of active worlds only."""


@dataclass(frozen=True)
class Contender:
    """One way to simulate.

    Attributes:
        prepare: Function that makes the ``Run`` from a configuration, attempts, and a number of actions.
        actions: Number of actions that take a CPU some seconds with 256 worlds.
        one_world: True if it simulates one world at a time, for any batch size.
        peer: Name of the required peer, if any.
    """

    prepare: Callable[[Config, Attempt, int], Run]
    actions: int
    one_world: bool = False
    peer: str | None = None


def attempts_of(config: Config, worlds: int) -> Attempt:
    """Draw the attempts that all contenders run: spirals of all pairs."""
    return draw_attempts(numerics.key(0), jnp.arange(worlds), "spiral", config)


def _engine(name: str, config: Config, attempts: Attempt, actions: int) -> Run:
    engine = make_engine(name, config)
    # MJX also computes finished worlds, but only active ones count.
    return lambda: int(engine.run(attempts, actions).felt.length.sum()) * SUBSTEPS


def _raw_batch(config: Config, attempts: Attempt, actions: int) -> Run:
    """Prepare MuJoCo alone on all threads, replaying the torques of ``native`` and so its contacts."""
    torque, engine = _recorded(config, attempts, actions)
    held = np.repeat(torque, config.scene.physics_steps, axis=1)

    def run() -> int:
        batch = engine.batch_at_rest(attempts)
        batch.rollout(held.shape[1], held, record=("sensordata",))
        return torque.shape[0] * torque.shape[1]

    return run


def _recorded(
    config: Config, attempts: Attempt, actions: int
) -> tuple[Float[np.ndarray, "n steps joints"], NativeEngine]:
    n = len(attempts.peg_type)
    torque, step = np.zeros((n, actions * SUBSTEPS, len(PANDA.joints))), np.zeros(n, int)

    def record(ids: np.ndarray, batch: Batch) -> None:
        torque[ids, step[ids]] = batch.bind("ctrl")
        step[ids] += 1

    engine = NativeEngine(config, THREADS, on_step=record)
    engine.run(attempts, actions)
    return torque, engine


def _mjx_step(config: Config, attempts: Attempt, actions: int) -> Run:
    """Prepare the JAX step alone, replaying the torques of ``native``."""
    torque, engine = _recorded(config, attempts, actions)
    stacked = Models.of(engine.scene)
    chain = chain_of(engine.scene.models[0])
    n = len(attempts.peg_type)
    cpu = jax.default_backend() == "cpu"
    parts = parts_of(n, THREADS if cpu else 1, MOST_ROWS if cpu else n)

    def world(model, qpos, hole, torque):
        data = placed(model, qpos, hole, engine.scene.plate_top_m)
        step = partial(advance, model, steps=engine.scene.config.physics_steps)
        _, wrench = jax.lax.scan(step, data, torque)
        return wrench.sum()

    @partial(jax.jit, compiler_options=compiler_options())
    def rollout(part: Attempt, torque):
        pair = pair_index(part.peg_type, part.hole_type, engine.scene.n_types)
        models, axes = stacked.of_worlds(pair, part.physics)
        qpos = start_qpos(chain, part, engine.config)
        with jax.default_matmul_precision("highest"):
            return jax.vmap(world, (axes, 0, 0, 0))(models, qpos, part.hole_pos_world, torque)

    work = [
        (jax.tree.map(lambda leaf, ids=ids: leaf[ids], attempts), torque[ids].astype(np.float32))
        for ids in parts
    ]

    def run() -> int:
        on_threads(THREADS, lambda item: jax.block_until_ready(rollout(*item)), work)
        return n * torque.shape[1]

    return run


def _python_loop(config: Config, attempts: Attempt, actions: int) -> Run:
    """Prepare the usual script: one world, ``mj_step`` in a loop, the same control law in NumPy."""
    peer = load_peer("python_loop")
    model, data, goal = peer.one_world(config, attempts)

    def run() -> int:
        for _ in range(actions * SUBSTEPS):
            mujoco.mj_step1(model, data)
            data.ctrl[:] = peer.torque(model, data, goal, config.control)
            mujoco.mj_step2(model, data)
            mujoco.mj_step(model, data, config.scene.physics_steps - 1)
        return actions * SUBSTEPS

    return run


CONTENDERS = {
    "raw_batch": Contender(_raw_batch, 40),
    "native": Contender(partial(_engine, "native"), 40),
    "mjx_step": Contender(_mjx_step, 20),
    "mjx": Contender(partial(_engine, "mjx"), 20),
    "python_loop": Contender(_python_loop, 100, one_world=True, peer="python_loop"),
}
