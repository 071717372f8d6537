"""A block of worlds in MuJoCo's C engine, and what the controller sees of them: a row of numbers for each."""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int
from mujoco.batch import Batch

from mjx_fit.control import operational_space
from mjx_fit.engines import plausible
from mjx_fit.scene.build import Scene, pair_index
from mjx_fit.types import SUBSTEPS, Array, Attempt

# Position- and velocity-dependent fields are current after each step; a persistent batch then continues from
# them, so that they are computed once.
_OBSERVED = mujoco.mjtStage.mjSTAGE_VEL


class Layout:
    """How the controller's inputs lie in one row of float32 numbers.

    Attributes:
        width: Numbers in a row.
        slices: Where each field lies.
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
        """The arm's state from one row, or from columns."""
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
    scene: Scene, attempts: Attempt, qpos: Float[np.ndarray, "n joints"], threads: int
) -> Batch:
    """A persistent batch of C simulations at the start of these attempts, held at rest against gravity."""
    pair = np.asarray(pair_index(attempts.peg_type, attempts.hole_type, scene.n_types))
    batch = Batch(scene.models[0], len(pair), threads, persistent=True)
    batch.set_models([scene.models[i] for i in pair])
    batch.bind("qpos")[:] = qpos
    hole = np.asarray(attempts.hole_pos_world)
    batch.bind("mocap_pos")[:, 0] = np.column_stack([hole, np.full(len(pair), scene.plate_top_m)])
    batch.forward(stage=_OBSERVED)
    batch.bind("ctrl")[:] = batch.bind("qfrc_bias")
    return batch


class Block:
    """Simulations of a few attempts, stepped together by one host thread.

    Attributes:
        batch: The simulations.
        tare_sensor: What their sensors read at rest (m, 6), N and N·m.
        qpos: Live view of the joint angles (m, joints), rad.
        qvel: Live view of the joint velocities (m, joints), rad/s.
        tip_pos_world: Live view of the tips (m, 3), m.
    """

    def __init__(
        self, scene: Scene, layout: Layout, attempts: Attempt, qpos: Float[np.ndarray, "m joints"], rows: int
    ):
        """Makes the simulations.

        Args:
            scene: Their scene.
            layout: How they are shown to the controller.
            attempts: What they are to do (m,).
            qpos: Joint angles at which they start, rad.
            rows: Most rows that the controller is shown; those beyond m mean nothing.
        """
        self._robot = scene.robot
        self.batch = batch = batch_at_rest(scene, attempts, qpos, threads=1)
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
        self._running = None  # all: then no list is looked at, which is some per cent faster
        self.show(np.arange(len(qpos)), rows)
        self.wrench = np.empty((SUBSTEPS, len(qpos), 6), np.float32)
        self._applied = np.zeros((SUBSTEPS, *qpos.shape), np.float32)
        batch.forward()
        self.tare_sensor = self._sensordata.astype(np.float32)

    def move(self, qpos: Float[np.ndarray, "m joints"], qvel: Float[np.ndarray, "m joints"]) -> None:
        """Puts the simulations into another state."""
        self.qpos[:], self.qvel[:] = qpos, qvel
        self.batch.forward(stage=_OBSERVED)

    def show(self, shown: Int[np.ndarray, "s"], rows: int) -> None:
        """Chooses the simulations whose inputs the controller is given, in this order.

        Args:
            shown: Which.
            rows: Rows that it is given, s or more.
        """
        # A slice where all are shown, since numbers are copied faster without a list.
        self._shown = slice(None) if len(shown) == len(self.qpos) else shown
        self._rows, self._inputs = self._packed[:rows], self._packed[: len(shown)]

    def run_only(self, running: Int[np.ndarray, "r"]) -> None:
        """Lets only these simulations go on."""
        self._running = running

    def packed(self) -> Float[np.ndarray, "rows k"]:
        """The controller's inputs of the simulations shown, in a buffer that the next call overwrites."""
        for where, field in self._fields:
            self._inputs[:, where] = field[self._shown]
        return self._rows

    def step(self, torque: Float[np.ndarray, "rows joints"], substep: int) -> None:
        """One step of the running simulations, under the torques (N·m) of those shown; notes what is felt."""
        self._ctrl[self._shown] = torque[: len(self._inputs)]
        self._applied[substep] = self._ctrl
        self.batch.step(self._running, stage=_OBSERVED)
        self.wrench[substep] = self._sensordata

    def finite(self) -> Bool[np.ndarray, "m"]:
        """Whether the state is finite (m,), and so were all torques of its last action.

        MuJoCo takes a torque that is not finite for zero: the arm would go limp and nobody would know.
        """
        state = np.concatenate([self.qpos, self.qvel], 1)
        return np.logical_and(np.isfinite(state).all(1), np.isfinite(self._applied).all((0, 2)))

    def at_limit(self) -> Bool[np.ndarray, "m"]:
        """Whether some joint was at its torque limit (m,) as the last action ended."""
        return np.asarray(plausible.at_limit(self._applied[-1], self._robot))
