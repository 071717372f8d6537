"""The native engine: MuJoCo's C engine on host threads, with the control and policies of the MJX engine.

Control is one jitted function over all worlds; each substep sends it one array and takes one back, since on a
CPU the cost of a dispatch grows with the number of its arguments.
"""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Callable
from functools import partial

import jax
import mujoco
import numpy as np
from jaxtyping import Bool, Float
from mujoco.batch import Batch

from mjx_fit import control, policies
from mjx_fit.config import Config
from mjx_fit.kinematics import chain_of
from mjx_fit.scene import pair_index, simulation_scene
from mjx_fit.simulate.engine import start_qpos
from mjx_fit.types import SUBSTEPS, Array, Attempt, Interaction, Trace

# Position- and velocity-dependent fields are current after each step; a persistent batch then continues from
# them, so that they are computed once.
_OBSERVED = mujoco.mjtStage.mjSTAGE_VEL


class NativeEngine:
    """Runs attempts in MuJoCo's C engine; see ``mjx_fit.simulate.engine.Engine``."""

    name = "native"

    def __init__(self, config: Config, threads: int, on_torque: Callable[[np.ndarray], None] | None = None):
        """Compiles the scene.

        Args:
            config: The configuration.
            threads: Host threads that step the worlds.
            on_torque: Told the torques (n, 7) of every step, N·m; the benchmark replays them.
        """
        self.scene = simulation_scene(config.scene)
        self._config = config
        self._threads, self._on_torque = threads, on_torque
        model = self.scene.models[0]
        self._layout = _Layout(model)
        self._start = jax.jit(partial(start_qpos, chain_of(model), scene=self.scene))
        self._torque = jax.jit(jax.vmap(self._torque_of))
        self._begin_action = jax.jit(jax.vmap(self._begin_action_of, (0, 0, None, None)), static_argnums=3)
        self._observe = jax.jit(jax.vmap(self._observe_of))

    def run(
        self, attempts: Attempt, actions: int, active: Bool[np.ndarray, "n"] | None = None
    ) -> Interaction:
        """See ``Engine.run``."""
        worlds = self.worlds(attempts)
        trace = _empty_trace(len(attempts.peg_type), actions)
        n = worlds.n
        length = np.zeros(n, np.int32)
        inserted, valid = np.zeros(n, bool), np.ones(n, bool)
        asked = np.ones(n, bool) if active is None else active
        depth = self.scene.plate_top_m - self._config.task.insertion_depth_m

        for step in range(actions):
            running = np.flatnonzero(asked & valid & ~inserted)
            if not len(running):
                break
            action, goal = self._begin_action(attempts, worlds.packed(), step, actions)
            trace.action_world[running, step] = np.asarray(action)[running]
            worlds.hold(goal, running, trace, step)
            velocity, quaternion = (np.asarray(value)[running] for value in self._observe(worlds.packed()))
            trace.tip_pos_world[running, step] = worlds.tip_pos[running]
            trace.tip_quat_world[running, step] = quaternion
            trace.tip_linvel_world[running, step] = velocity[:, :3]
            trace.tip_angvel_world[running, step] = velocity[:, 3:]
            length[running] = step + 1
            valid[running] = np.isfinite(worlds.qpos[running]).all(1)
            inserted[running] = valid[running] & (worlds.tip_pos[running, 2] <= depth)

        return Interaction(
            trace=trace,
            length=length,
            inserted=inserted,
            peg_type=np.asarray(attempts.peg_type),
            hole_type=np.asarray(attempts.hole_type),
            hole_pos_world=np.asarray(attempts.hole_pos_world),
            estimate_world=np.asarray(attempts.estimate_world),
            tare_sensor=worlds.tare,
            valid=valid,
        )

    def worlds(self, attempts: Attempt) -> "_Worlds":
        """Simulations at rest at the start of these attempts."""
        return _Worlds(self, attempts)

    def _torque_of(self, packed: Float[Array, "k"], goal_pos_world: Float[Array, "3"]) -> Float[Array, "7"]:
        return control.torque(self._layout.unpack(packed), goal_pos_world, self._config.control)

    def _begin_action_of(self, attempt: Attempt, packed: Float[Array, "k"], step, actions: int):
        tip = self._layout.unpack(packed).tip_pos_world
        action = policies.action(attempt, step, actions, tip, self._config)
        return action, tip + action

    def _observe_of(self, packed: Float[Array, "k"]):
        arm = self._layout.unpack(packed)
        return control.tip_velocity(arm), control.tip_quaternion(arm)


class _Layout:
    """How the controller's inputs lie in one row of float32 numbers."""

    FIELDS = ("qpos", "qvel", "qfrc_bias", "M", "xanchor", "xaxis", "site_xpos", "site_xmat")

    def __init__(self, model: mujoco.MjModel):
        self.tip = model.site("tip").id
        sizes = {"M": model.nM, "xanchor": 21, "xaxis": 21, "site_xpos": 3, "site_xmat": 9}
        ends = np.cumsum([sizes.get(name, model.nv) for name in self.FIELDS])
        self.width = int(ends[-1])
        self.slices = {
            name: slice(int(end) - sizes.get(name, model.nv), int(end))
            for name, end in zip(self.FIELDS, ends, strict=True)
        }
        # Dense index of MuJoCo's sparse lower triangle, mirrored.
        rows = np.repeat(np.arange(model.nv), model.M_rownnz)
        self.mass_index = np.zeros((model.nv, model.nv), int)
        self.mass_index[rows, model.M_colind] = np.arange(model.nM)
        self.mass_index[model.M_colind, rows] = np.arange(model.nM)

    def unpack(self, packed: Float[Array, "k"]) -> control.ArmState:
        part = {name: packed[where] for name, where in self.slices.items()}
        return control.ArmState(
            qpos=part["qpos"],
            qvel=part["qvel"],
            mass_matrix=part["M"][self.mass_index],
            bias=part["qfrc_bias"],
            tip_pos_world=part["site_xpos"],
            tip_frame_world=part["site_xmat"].reshape(3, 3),
            joint_anchor_world=part["xanchor"].reshape(7, 3),
            joint_axis_world=part["xaxis"].reshape(7, 3),
        )


class _Worlds:
    """A batch of simulations at the start of their attempts."""

    def __init__(self, engine: NativeEngine, attempts: Attempt):
        scene, layout = engine.scene, engine._layout
        pair = np.asarray(pair_index(attempts.peg_type, attempts.hole_type))
        self.n = len(pair)
        self._engine = engine
        self.batch = batch = Batch(scene.models[0], self.n, engine._threads, persistent=True)
        batch.set_models([scene.models[i] for i in pair])
        self.qpos, self._ctrl = batch.bind("qpos"), batch.bind("ctrl")
        self._sensordata, self._contact_force = batch.bind("sensordata"), batch.bind("qfrc_constraint")
        self.tip_pos = batch.bind("site_xpos")[:, layout.tip]
        self._fields = []
        for name, where in layout.slices.items():
            field = batch.bind(name)
            if name.startswith("site"):
                field = field[:, layout.tip]
            self._fields.append((where, field.reshape(self.n, -1)))
        self._packed = np.empty((self.n, layout.width), np.float32)

        self.qpos[:] = np.asarray(engine._start(attempts=attempts))
        hole = np.asarray(attempts.hole_pos_world)
        batch.bind("mocap_pos")[:, 0] = np.column_stack([hole, np.full(self.n, scene.plate_top_m)])
        batch.forward(stage=_OBSERVED)
        self._ctrl[:] = batch.bind("qfrc_bias")
        batch.forward()
        self.tare = self._sensordata.astype(np.float32)

    def packed(self) -> np.ndarray:
        """The controller's inputs of all worlds, (n, k), in a buffer that the next call overwrites."""
        for where, field in self._fields:
            self._packed[:, where] = field
        return self._packed

    def hold(self, goal_pos_world: Array, running: np.ndarray, trace: Trace, step: int) -> None:
        """Pulls the tips of the running worlds to their goals for one action, and records what they feel."""
        for substep in range(SUBSTEPS):
            torque = np.asarray(self._engine._torque(self.packed(), goal_pos_world))
            if self._engine._on_torque is not None:
                self._engine._on_torque(torque)
            self._ctrl[:] = torque
            self.batch.step(running, stage=_OBSERVED)
            trace.wrench_sensor[running, step, substep] = self._sensordata[running]
            trace.contact[running, step] |= (self._contact_force[running] != 0).any(1)


def _empty_trace(n: int, actions: int) -> Trace:
    zeros = partial(np.zeros, dtype=np.float32)
    return Trace(
        wrench_sensor=zeros((n, actions, SUBSTEPS, 6)),
        tip_pos_world=zeros((n, actions, 3)),
        tip_quat_world=zeros((n, actions, 4)),
        tip_linvel_world=zeros((n, actions, 3)),
        tip_angvel_world=zeros((n, actions, 3)),
        contact=np.zeros((n, actions), bool),
        action_world=zeros((n, actions, 3)),
    )
