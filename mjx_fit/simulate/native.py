"""The native engine: MuJoCo's C engine on host threads, with the control and policies of the MJX engine.

Each host thread takes a block of worlds through its attempts: few enough to stay in its cache, many enough
that control, one jitted function over a block, is cheap for each. An attempt's trace does not depend on which
others are run beside it, nor on how many.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from mujoco.batch import Batch

from mjx_fit import control, interrupts, numerics, policies
from mjx_fit.config import Config
from mjx_fit.kinematics import chain_of
from mjx_fit.scene import simulation_scene
from mjx_fit.simulate.block import Block, Layout, batch_at_rest
from mjx_fit.simulate.engine import is_inserted, silence_mujoco, start_qpos
from mjx_fit.simulate.plausible import LIMIT_ACTIONS, actions_at_limit, is_lost
from mjx_fit.simulate.requests import MOST_THREADS, require_attempts, require_count
from mjx_fit.simulate.threads import on_threads, parts_of
from mjx_fit.types import SUBSTEPS, Array, Attempt, Interaction, Trace

CHUNK = 32
"""Rows that the controller computes at a time: larger intermediate results made a call several times slower.
Always so many also means the same bits for the torques, whatever the block."""

ROWS = (32, 64, 128, 256, 512)
"""Rows that the controller is compiled for: a block holds at most the last, and takes the least that it fits.
The larger the block, the less often a thread changes between physics and control, whose code and data push
each other out of its cache. What an action starts and ends with is computed for all rows, with the same bits
too (tests/test_engines.py)."""

OnStep = Callable[[Int[np.ndarray, "m"], Batch], None]


class NativeEngine:
    """Runs attempts in MuJoCo's C engine; see ``mjx_fit.simulate.engine.Engine``."""

    name = "native"

    def __init__(
        self,
        config: Config,
        threads: int,
        policy: policies.Policy = policies.action,
        on_step: OnStep | None = None,
    ):
        """Compiles the scene.

        Args:
            config: The configuration.
            threads: Host threads that step the worlds.
            policy: Gives the actions; the library's are those that an attempt names.
            on_step: Told, after every step of a block, which worlds it holds and their batch; from several
                threads at once. For benchmarks and experiments.

        Raises:
            RequestError: The number of threads is not allowed.
        """
        numerics.require()
        threads = require_count("threads", threads, 1, MOST_THREADS)
        silence_mujoco()
        self.scene = simulation_scene(config.scene)
        self._config = config
        self._threads, self._policy, self._on_step = threads, policy, on_step
        model = self.scene.models[0]
        self._layout = Layout(model)
        self._start = jax.jit(partial(start_qpos, chain_of(model), scene=self.scene))
        self._torque = jax.jit(self._torques_of)
        self._begin_action = jax.jit(jax.vmap(self._begin_action_of, (0, 0, None, None)), static_argnums=3)
        self._observe = jax.jit(jax.vmap(self._observe_of))

    def run(
        self,
        attempts: Attempt,
        actions: int,
        active: Bool[np.ndarray, "n"] | None = None,
        horizon: int | None = None,
    ) -> Interaction:
        """See ``Engine.run``."""
        numerics.require()
        actions, horizon, active = require_attempts(attempts, actions, horizon, active, self._policy)
        done = _nothing_done(attempts, actions)
        wanted = np.flatnonzero(active)
        parts = [wanted[part] for part in parts_of(len(wanted), self._threads, ROWS[-1])]

        def run_part(ids: Int[np.ndarray, "m"]) -> None:
            self._run_block(ids, attempts, actions, horizon, done)

        on_threads(self._threads, run_part, parts)
        return done

    def act(
        self,
        attempts: Attempt,
        qpos: Float[np.ndarray, "m 7"],
        qvel: Float[np.ndarray, "m 7"],
        step: int,
        horizon: int,
    ) -> Interaction:
        """One action of a few attempts, up to 512, from any state: only its row is filled.

        Args:
            attempts: A batch (m,).
            qpos: Joint angles, rad.
            qvel: Joint velocities, rad/s.
            step: Number j of the action.
            horizon: Actions that the policy plans for: as many rows come back.
        """
        done, ids = _nothing_done(attempts, horizon), np.arange(len(qpos))
        block = Block(self.scene, self._layout, attempts, qpos, _rows_for(len(ids)))
        block.move(qpos, qvel)
        self._act(block, ids, ids, ids, _rows(attempts, ids), step, horizon, done)
        return done

    def batch_at_rest(self, attempts: Attempt) -> Batch:
        """All these attempts as one batch of C simulations on all threads, at rest where they start."""
        ids = np.arange(len(attempts.peg_type))
        parts = parts_of(len(ids), 1, ROWS[-1])
        qpos = np.concatenate([self._start_of(_rows(attempts, part))[: len(part)] for part in parts])
        return batch_at_rest(self.scene, attempts, qpos, self._threads)

    def _run_block(
        self, ids: Int[np.ndarray, "m"], attempts: Attempt, actions: int, horizon: int, done: Interaction
    ) -> None:
        """Runs the attempts with these ids and writes what comes of them into their rows of ``done``.

        Args:
            ids: Which attempts.
            attempts: All attempts.
            actions: Most actions in one attempt.
            horizon: Actions that the policy plans for.
            done: Arrays over all attempts.
        """
        rows = _rows(attempts, ids)
        own = jax.tree.map(lambda leaf: leaf[: len(ids)], rows)
        start = self._start_of(rows)[: len(ids)]
        block = Block(self.scene, self._layout, own, start, _rows_for(len(ids)))
        done.tare_sensor[ids] = block.tare_sensor
        hole, depth = np.asarray(own.hole_pos_world), self._config.task.insertion_depth_m
        running = shown = np.arange(len(ids))
        held = np.zeros(len(ids), np.int32)
        for step in range(actions):
            interrupts.check()
            before = block.qpos.copy(), block.qvel.copy()
            self._act(block, ids, running, shown, rows, step, horizon, done)
            held = actions_at_limit(held, block.at_limit())
            trace = done.trace
            lost = is_lost(
                trace.tip_pos_world[ids, step], trace.tip_quat_world[ids, step], hole, self._config.scene
            )
            valid = block.finite() & ~lost & (held < LIMIT_ACTIONS)
            inserted = valid & is_inserted(block.tip_pos_world, hole, self.scene, depth)
            done.length[ids[running]] = step + 1
            done.valid[ids[running]] = valid[running]
            done.inserted[ids[running]] = inserted[running]
            done.end_qpos[ids[running]] = np.where(valid[:, None], block.qpos, before[0])[running]
            done.end_qvel[ids[running]] = np.where(valid[:, None], block.qvel, before[1])[running]
            over = (~valid | inserted)[running]
            if over.all():
                return
            if over.any():
                running = running[~over]
                block.run_only(running)
                if _rows_for(len(running)) < len(rows.peg_type):
                    shown, rows = running, _rows(attempts, ids[running])
                    block.show(shown, len(rows.peg_type))

    def _act(
        self,
        block: Block,
        ids: Int[np.ndarray, "m"],
        running: Int[np.ndarray, "r"],
        shown: Int[np.ndarray, "s"],
        rows: Attempt,
        step: int,
        horizon: int,
        done: Interaction,
    ) -> None:
        """One action of the running attempts: pulls each tip to its goal, and records what happens.

        Args:
            block: The simulations.
            ids: Which attempts they are of.
            running: Which of them run, in order.
            shown: Which of them the controller is given, in order: these, and finished ones, as long as no
                smaller number of rows would do.
            rows: The attempts of those shown, padded.
            step: Number j of the action.
            horizon: Actions that the policy plans for.
            done: Arrays over all attempts.
        """
        action, goal = self._begin_action(rows, block.packed(), step, horizon)
        for substep in range(SUBSTEPS):
            block.step(np.asarray(self._torque(block.packed(), goal)), substep)
            if self._on_step is not None:
                self._on_step(ids, block.batch)
        place = np.searchsorted(shown, running)
        velocity, quaternion = (np.asarray(x)[place] for x in self._observe(block.packed()))
        row = Trace(
            wrench_sensor=block.wrench.swapaxes(0, 1)[running],
            tip_pos_world=block.tip_pos_world[running],
            tip_quat_world=quaternion,
            tip_linvel_world=velocity[:, :3],
            tip_angvel_world=velocity[:, 3:],
            contact=block.touched()[running],
            action_world=np.asarray(action)[place],
        )
        for stored, now in zip(jax.tree.leaves(done.trace), jax.tree.leaves(row), strict=True):
            stored[ids[running], step] = now

    def _start_of(self, rows: Attempt) -> Float[np.ndarray, "rows 7"]:
        return np.asarray(self._start(attempts=rows))

    def _torques_of(
        self, packed: Float[Array, "rows k"], goal_pos_world: Float[Array, "rows 3"]
    ) -> Float[Array, "rows 7"]:
        def chunk(part):
            rows, goal = part
            return control.torque(self._layout.unpack(rows.T), goal.T, self._config.control).T

        chunks = (x.reshape(-1, CHUNK, x.shape[1]) for x in (packed, goal_pos_world))
        return jax.lax.map(chunk, tuple(chunks)).reshape(-1, 7)

    def _begin_action_of(self, attempt: Attempt, packed: Float[Array, "k"], step, horizon: int):
        tip = self._layout.unpack(packed).tip_pos_world
        action = self._policy(attempt, step, horizon, tip, self._config)
        return action, tip + action

    def _observe_of(self, packed: Float[Array, "k"]):
        arm = self._layout.unpack(packed)
        return control.tip_velocity(arm), control.tip_quaternion(arm)


def _rows_for(n: int) -> int:
    """Rows of the controller for n worlds."""
    return next(rows for rows in ROWS if rows >= n)


def _rows(attempts: Attempt, ids: Int[np.ndarray, "m"]) -> Attempt:
    """The attempts with these ids, padded to as many rows as the controller takes."""
    padded = np.concatenate([ids, np.repeat(ids[-1:], _rows_for(len(ids)) - len(ids))])

    def take(leaf):
        if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            data = jnp.asarray(np.asarray(jax.random.key_data(leaf))[padded])
            return jax.random.wrap_key_data(data, impl=jax.random.key_impl(leaf))
        return np.asarray(leaf)[padded]

    return jax.tree.map(take, attempts)


def _nothing_done(attempts: Attempt, actions: int) -> Interaction:
    """Interactions of length 0, as arrays to write into."""
    n = len(attempts.peg_type)
    zeros = partial(np.zeros, dtype=np.float32)
    trace = Trace(
        wrench_sensor=zeros((n, actions, SUBSTEPS, 6)),
        tip_pos_world=zeros((n, actions, 3)),
        tip_quat_world=zeros((n, actions, 4)),
        tip_linvel_world=zeros((n, actions, 3)),
        tip_angvel_world=zeros((n, actions, 3)),
        contact=np.zeros((n, actions), bool),
        action_world=zeros((n, actions, 3)),
    )
    return Interaction(
        trace=trace,
        length=np.zeros(n, np.int32),
        inserted=np.zeros(n, bool),
        peg_type=np.asarray(attempts.peg_type),
        hole_type=np.asarray(attempts.hole_type),
        hole_pos_world=np.asarray(attempts.hole_pos_world),
        estimate_world=np.asarray(attempts.estimate_world),
        tare_sensor=zeros((n, 6)),
        end_qpos=zeros((n, 7)),
        end_qvel=zeros((n, 7)),
        valid=np.ones(n, bool),
    )
