"""Block of worlds in MuJoCo's C engine, with one row of controller inputs per world."""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int
from mujoco.batch import Batch

from mjx_fit.control import operational_space
from mjx_fit.engines import plausible
from mjx_fit.engines.native.models import Models
from mjx_fit.scene.build import Scene, pair_index
from mjx_fit.scene.placement import Setting
from mjx_fit.types import Array, Attempt
from mjx_fit.utils.rates import SUBSTEPS

# Each step updates the position- and velocity-dependent fields. A persistent batch continues from them, so
# each is computed only once.
_OBSERVED = mujoco.mjtStage.mjSTAGE_VEL


class Layout:
    """Layout of the controller's inputs in one row of float32 numbers.

    Attributes:
        width: Number of values in a row.
        slices: Position of each field in the row.
    """

    _FIELDS = ("qpos", "qvel", "qfrc_bias", "M", "xanchor", "xaxis", "site_xpos", "site_xmat")

    def __init__(self, scene: Scene):
        model = scene.models[0]
        self.tip = model.site(scene.robot.tool_site).id
        sizes = {
            "M": model.nM,
            "xanchor": 3 * model.nv,
            "xaxis": 3 * model.nv,
            "site_xpos": 3,
            "site_xmat": 9,
        }
        ends = np.cumsum([sizes.get(name, model.nv) for name in self._FIELDS])
        self.width = int(ends[-1])
        self.slices = {
            name: slice(int(end) - sizes.get(name, model.nv), int(end))
            for name, end in zip(self._FIELDS, ends, strict=True)
        }
        # Dense index of MuJoCo's sparse lower triangle, mirrored.
        rows = np.repeat(np.arange(model.nv), model.M_rownnz)
        self._mass_index = np.zeros((model.nv, model.nv), int)
        self._mass_index[rows, model.M_colind] = np.arange(model.nM)
        self._mass_index[model.M_colind, rows] = np.arange(model.nM)

    def unpack(self, packed: Float[Array, "k *b"]) -> operational_space.ArmState:
        """Unpack the arm's state from one row, or from columns."""
        worlds = packed.shape[1:]
        part = {name: packed[where] for name, where in self.slices.items()}
        return operational_space.ArmState(
            qpos=part["qpos"],
            qvel=part["qvel"],
            mass_matrix=part["M"][self._mass_index],
            bias=part["qfrc_bias"],
            tip_pos_world=part["site_xpos"],
            tip_frame_world=part["site_xmat"].reshape(3, 3, *worlds),
            joint_anchor_world=part["xanchor"].reshape(-1, 3, *worlds),
            joint_axis_world=part["xaxis"].reshape(-1, 3, *worlds),
        )


def batch_at_rest(
    models: Models, attempts: Attempt, setting: Setting, qpos: Float[np.ndarray, "n joints"], threads: int
) -> Batch:
    """Create a persistent batch of C simulations at the start of these attempts, at rest against gravity."""
    scene = models.scene
    pair = np.asarray(pair_index(attempts.peg_type, attempts.hole_type, scene.n_types))
    batch = Batch(scene.models[0], len(pair), threads, persistent=True)
    batch.set_models(models.of(pair, attempts.physics, setting.peg_hand))
    _place(batch, np.arange(len(pair)), setting, qpos, scene.plate_top_m)
    return batch


def _place(
    batch: Batch,
    rows: Int[np.ndarray, "k"],
    setting: Setting,
    qpos: Float[np.ndarray, "k joints"],
    top_m: float,
) -> None:
    """Put these simulations at the start of their attempts, at rest against gravity."""
    batch.bind("qpos")[rows], batch.bind("qvel")[rows] = qpos, 0
    batch.bind("qacc_warmstart")[rows] = 0  # a world that was here before may have diverged
    hole, socket = np.asarray(setting.hole_pos_world), setting.socket_world
    upright = np.column_stack([hole, np.full(len(rows), top_m)])
    place = upright if socket is None else np.asarray(socket.translation())
    batch.bind("mocap_pos")[rows, 0] = place
    if socket is not None:
        batch.bind("mocap_quat")[rows, 0] = np.asarray(socket.rotation().wxyz)
    batch.forward(rows, stage=_OBSERVED)
    batch.bind("ctrl")[rows] = batch.bind("qfrc_bias")[rows]


class Block:
    """Simulations of a few attempts, stepped together by one host thread.

    Attributes:
        batch: The simulations.
        tare_sensor: F/T sensor readings at rest (m, 6), N and N·m.
        qpos: Live view of the joint angles (m, joints), rad.
        qvel: Live view of the joint velocities (m, joints), rad/s.
        tip_pos_world: Live view of the TCP positions (m, 3), m.
    """

    def __init__(
        self,
        models: Models,
        layout: Layout,
        attempts: Attempt,
        setting: Setting,
        qpos: Float[np.ndarray, "m joints"],
        rows: int,
    ):
        """Create the simulations.

        Args:
            models: Models of the scene.
            layout: Layout of the controller's inputs.
            attempts: Attempts to simulate (m,).
            setting: Their settings.
            qpos: Joint angles at the start, rad.
            rows: Maximum number of rows for the controller; rows beyond m are meaningless.
        """
        self._robot, self._models = models.scene.robot, models
        self.batch = batch = batch_at_rest(models, attempts, setting, qpos, threads=1)
        self.qpos, self.qvel, self._ctrl = (batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
        self._sensordata = batch.bind("sensordata")
        self.tip_pos_world = batch.bind("site_xpos")[:, layout.tip]
        self._fields = []
        for name, where in layout.slices.items():
            field = batch.bind(name)
            if name.startswith("site"):
                field = field[:, layout.tip]
            self._fields.append((where, field.reshape(len(qpos), -1)))
        self._packed = np.zeros((rows, layout.width), np.float32)
        self._steps = models.scene.config.physics_steps
        self._running = None  # all: a step without an index list is some per cent faster
        self.show(np.arange(len(qpos)), rows)
        self.wrench = np.empty((SUBSTEPS, len(qpos), 6), np.float32)
        self._applied = np.zeros((SUBSTEPS, *qpos.shape), np.float32)
        batch.forward()
        self.tare_sensor = self._sensordata.astype(np.float32)

    def move(self, qpos: Float[np.ndarray, "m joints"], qvel: Float[np.ndarray, "m joints"]) -> None:
        """Set the state of the simulations."""
        self.qpos[:], self.qvel[:] = qpos, qvel
        self.batch.forward(stage=_OBSERVED)

    def hold(self, rows: Int[np.ndarray, "k"], attempts: Attempt, setting: Setting) -> None:
        """Give these simulations the models of attempts (k,): their parts, contact, and grasps."""
        pair = np.asarray(pair_index(attempts.peg_type, attempts.hole_type, self._models.scene.n_types))
        of_worlds = [self.batch.get_model(world) for world in range(len(self.qpos))]
        for row, model in zip(rows, self._models.of(pair, attempts.physics, setting.peg_hand), strict=True):
            of_worlds[row] = model
        self.batch.set_models(of_worlds)

    def restart(
        self,
        rows: Int[np.ndarray, "k"],
        attempts: Attempt,
        setting: Setting,
        qpos: Float[np.ndarray, "k joints"],
    ) -> None:
        """Begin new attempts (k,) in these simulations, at rest; the others stay as they are."""
        self.hold(rows, attempts, setting)
        _place(self.batch, rows, setting, qpos, self._models.scene.plate_top_m)
        self.batch.forward(rows)
        self.tare_sensor[rows] = self._sensordata[rows]

    def show(self, shown: Int[np.ndarray, "s"], rows: int) -> None:
        """Select the simulations whose inputs the controller receives, in this order.

        Args:
            shown: Indices of the simulations.
            rows: Number of rows for the controller, s or more.
        """
        # Use a slice if all are shown: it copies faster than an index list.
        self._shown = slice(None) if len(shown) == len(self.qpos) else shown
        self._rows, self._inputs = self._packed[:rows], self._packed[: len(shown)]

    def run_only(self, running: Int[np.ndarray, "r"]) -> None:
        """Restrict the following steps to these simulations."""
        self._running = running

    def packed(self) -> Float[np.ndarray, "rows k"]:
        """Return the controller's inputs in a buffer that the next call overwrites."""
        for where, field in self._fields:
            self._inputs[:, where] = field[self._shown]
        return self._rows

    def step(self, torque: Float[np.ndarray, "rows joints"], substep: int) -> None:
        """Step the running simulations under the given torques (N·m), and record the wrenches."""
        self._ctrl[self._shown] = torque[: len(self._inputs)]
        self._applied[substep] = self._ctrl
        self.batch.step(self._running, self._steps, stage=_OBSERVED)
        self.wrench[substep] = self._sensordata

    def finite(self) -> Bool[np.ndarray, "m"]:
        """Check that the state and all torques of the last action are finite, (m,).

        MuJoCo replaces a non-finite torque by zero, so the arm would silently go limp.
        """
        state = np.concatenate([self.qpos, self.qvel], 1)
        return np.logical_and(np.isfinite(state).all(1), np.isfinite(self._applied).all((0, 2)))

    def at_limit(self) -> Bool[np.ndarray, "m"]:
        """Check whether any joint was at its torque limit at the end of the last action, (m,)."""
        return np.asarray(plausible.at_limit(self._applied[-1], self._robot))
