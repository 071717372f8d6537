"""Check contact of any part: insertion from a known pose, impossible insertions, and centres of pressure.

    python experiments/parts/right.py [known_pose] [impossible] [edges]

All checks by default; the others in ``right.json`` are kept.
``known``: attempts that start above the true hole, readings exact, no dither, a spiral of 2 mm; and the same
with the default world's readings and policy. ``impossible``: attempts of NIST's pegs at holes that geometry
says they cannot enter at any yaw. ``edges``: a peg whose axis is beyond a straight rim of a larger hole
presses on the plate, held softly, so that it rolls. Statics sets its centre of pressure: the supported point
of its face that is nearest to the axis: a rim, or an inner side of a prong. The exact pose gives the rim.
"""

# pyright: reportAttributeAccessIssue=false
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import shapely
from shapely import MultiPolygon

from mjx_fit.config.files import read_config
from mjx_fit.config.part_sets import parts_file
from mjx_fit.config.schema import Config
from mjx_fit.config.sections.cross_section import CrossSection, Rectangle
from mjx_fit.config.sections.shape import Shape
from mjx_fit.config.worlds import world_file
from mjx_fit.control.policies import PolicyInput, stateless
from mjx_fit.data.schedule import draw_places
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.engines.select import make_engine
from mjx_fit.report import script
from mjx_fit.scene.build import pair_index
from mjx_fit.scene.fits import fitting
from mjx_fit.scene.outline import peg_outline
from mjx_fit.task.attempt_loop import spirals_at
from mjx_fit.types import Attempt, Rollout, Trace
from mjx_fit.utils import process_setup
from mjx_fit.utils.randomness import root_key
from mjx_fit.utils.rates import SUBSTEPS

HERE = Path(__file__).parent
KNOWN_EACH, DEFAULT_EACH, IMPOSSIBLE = 300, 100, 1000
EXACT = ("spiral.radius_m=0.002", "spiral.turns=4", "spiral.wiggle_m=0")
ALLOWED_SHARE = 0.1
STATE, TIME = mujoco.mjtState.mjSTATE_INTEGRATION, 0
"""All that a step depends on, and the place of the time in it. Torques of finished attempts still change."""
GAP_M = 0.0001
RIM_M, OVERHANGS_M, PUSH_M, ACTIONS = 0.015, (0.004, 0.006, 0.008), 0.004, 20
"""Distance of the rim from the hole's centre, of the peg's axis from the rim, depth of the goal; duration."""


def main(wanted: list[str]) -> None:
    """Run the checks and write the table."""
    exact = read_config([*world_file("paper"), *parts_file("nist")], EXACT)
    default = read_config(parts_file("nist"))
    checks = {
        "known_pose": lambda: {
            "exact": known_poses(exact, KNOWN_EACH),
            "default": known_poses(default, DEFAULT_EACH),
        },
        "impossible": lambda: impossible_attempts(exact),
        "edges": lambda: [row for name in ("native", "mjx") for row in pressed(name)],
    }
    file = HERE / "right.json"
    results = json.loads(file.read_text()) if file.exists() else {}
    for name in wanted or checks:
        results[name] = checks[name]()
        script.save(file, results | {"holds": holds(results)})


def holds(results: dict[str, Any]) -> dict[str, bool]:
    """Compare the results with what is asked."""
    found = {}
    if known := results.get("known_pose"):
        found["inserted"] = all(row["inserted"] >= 0.99 for row in known["exact"].values())
        found["penetration"] = all(
            row["penetration_over_clearance"]["q99.9"] < ALLOWED_SHARE
            for rows in known.values()
            for row in rows.values()
        )
    if impossible := results.get("impossible"):
        found["nothing_impossible"] = impossible["inserted"] == 0
    if edges := results.get("edges"):
        found["centre_of_pressure_within_0.2_mm"] = max(abs(row["error_mm"]) for row in edges) < 0.2
    return found


def known_poses(config: Config, each: int) -> dict[str, dict[str, Any]]:
    """Start attempts above the true holes of all parts; return insertions and penetrations by part."""
    scene = config.scene
    kind = np.repeat(np.arange(scene.n_types), each)
    done, depth = deepest(config, attempts_at(config, kind, kind))
    rows = {}
    for i, shape in enumerate(scene.shapes):
        own = depth[kind == i]
        share = own[own > 0] / scene.clearance_of(shape)
        levels = {"q50": 0.5, "q99": 0.99, "q99.9": 0.999, "max": 1.0}
        rows[shape.name] = {
            "attempts": each,
            "inserted": float(done.truth.inserted[kind == i].mean()),
            "invalid": int((~done.truth.valid[kind == i]).sum()),
            "penetration_over_clearance": {name: float(np.quantile(share, q)) for name, q in levels.items()},
        }
        print(shape.name, rows[shape.name], flush=True)
    return rows


def attempts_at(config: Config, peg: np.ndarray, hole: np.ndarray) -> Attempt:
    """Place holes and start above their true positions."""
    places = draw_places(root_key(0, "right"), jnp.arange(len(peg)), config)
    there = places.hole_pos_world
    return spirals_at(peg, hole, there, there, places.key, places.physics)


def deepest(config: Config, attempts: Attempt) -> tuple[Rollout, np.ndarray]:
    """Run attempts in C; return them with the deepest penetration during each torque (n, torques), m.

    A torque is simulated once more, from the state before it, to see all of its physics steps.
    """
    actions = config.task.attempt_actions
    n = len(attempts.peg_type)
    depth, torque = np.zeros((n, actions * SUBSTEPS), np.float32), np.zeros(n, int)
    pair = np.asarray(pair_index(attempts.peg_type, attempts.hole_type, config.scene.n_types))
    before: dict[int, np.ndarray] = {}

    def look(ids: np.ndarray, batch) -> None:
        data, again = (mujoco.MjData(engine.scene.models[0]) for _ in range(2))
        state = np.empty(mujoco.mj_stateSize(engine.scene.models[0], STATE))
        for i, world in enumerate(ids):
            model = engine.scene.models[pair[world]]
            batch.get_data(i, data)
            mujoco.mj_getState(model, data, state, STATE)
            rests = world not in before or data.time == before[world][TIME]  # at its start or end
            if data.ncon and not rests:
                mujoco.mj_setState(model, again, before[world], STATE)
                again.ctrl[:] = data.ctrl
                for _ in range(config.scene.physics_steps):
                    mujoco.mj_step(model, again)
                    depth[world, torque[world]] = max(depth[world, torque[world]], deepest_of(again))
                assert np.array_equal(again.qpos, data.qpos)
            before[world] = state.copy()
        torque[ids] += 1

    engine = NativeEngine(config, 2, on_step=look)
    return engine.run(attempts, actions), depth


def deepest_of(data: Any) -> float:
    """Return the deepest penetration of a state, m."""
    return -float(data.contact.dist.min()) if data.ncon else 0.0


def impossible_attempts(config: Config) -> dict[str, Any]:
    """Try pegs at holes that they cannot enter at any yaw, from above the holes."""
    config = replace(config, spiral=replace(config.spiral, radius_m=0.005))
    pairs = np.argwhere(~fitting(config.scene, turned=True))
    peg, hole = pairs[np.arange(IMPOSSIBLE) % len(pairs)].T
    done = make_engine("native", config).run(attempts_at(config, peg, hole), config.task.attempt_actions)
    return {
        "attempts": IMPOSSIBLE,
        "pairs": len(pairs),
        "inserted": int(done.truth.inserted.sum()),
        "invalid": int((~done.truth.valid).sum()),
    }


def pressed(engine: str) -> list[dict[str, Any]]:
    """Press pegs on the rim of a larger hole; return errors of the centre of pressure by peg and overhang."""
    shafts = read_config(parts_file("shafts")).scene
    slot = Shape("slot", section=CrossSection(rectangle=Rectangle((2 * (RIM_M - GAP_M), 0.05))))
    pegs = tuple(shape for shape in shafts.shapes if shape.name in ("hexagon", "d_shaft", "tube", "prongs"))
    config = read_config(world_file("paper"), ["control.kp_orientation=100", "task.outcome_model=constant"])
    task = replace(config.task, success_probability=None, success_by_error=None)
    config = replace(config, scene=replace(shafts, shapes=(*pegs, slot), clearance_m=GAP_M), task=task)
    kind, overhang = (grid.ravel() for grid in np.meshgrid(np.arange(len(pegs)), OVERHANGS_M, indexing="ij"))
    n = len(kind)
    hole = np.tile(np.array([0.5, 0.0], np.float32), (n, 1))
    estimate = hole + np.column_stack([RIM_M - overhang, np.zeros(n)]).astype(np.float32)
    asked = spirals_at(kind, np.full(n, len(pegs)), hole, estimate, jax.random.split(root_key(0, "edges"), n))

    def hold(seen: PolicyInput):
        return jnp.append(seen.start.estimate_world - seen.tip_pos_world[:2], -PUSH_M)

    running = make_engine(engine, config, policy=stateless(hold))
    done = running.run(asked, ACTIONS)
    outlines = [peg_outline(shape, config.scene) for shape in pegs]
    rows = []
    for i in range(n):
        trace = jax.tree.map(lambda leaf, i=i: np.asarray(leaf[i, -1], float), done.felt.trace)
        wrench = np.asarray(trace.wrench_sensor.mean(0) - done.felt.tare_sensor[i])
        centre = centre_on_face(running.scene.models[0], wrench)
        expected = edge_in_face(outlines[kind[i]], trace, float(hole[i, 0]) + RIM_M)
        rows.append(
            {
                "engine": engine,
                "peg": pegs[kind[i]].name,
                "overhang_mm": 1e3 * float(overhang[i]),
                "force_n": float(np.linalg.norm(wrench[:3])),
                "tilt_deg": float(
                    np.degrees(np.arccos(min(1.0, -axes_of(np.asarray(trace.tip_quat_world))[2, 2])))
                ),
                "expected_mm": 1e3 * expected,
                "error_mm": 1e3 * float(centre[0] - expected),
                "beside_mm": 1e3 * float(centre[1]),
            }
        )
        print(rows[-1], flush=True)
    return rows


def edge_in_face(peg: MultiPolygon, trace: Trace, rim_m: float) -> float:
    """Return where the supported part of a peg's face begins along the face's x axis, m.

    The rim is a line along y at the plate's top, which the face's own x axis meets.
    """
    rim = (rim_m - trace.tip_pos_world[0]) / axes_of(np.asarray(trace.tip_quat_world))[0, 0]
    return float(peg.intersection(shapely.box(rim, -1, 1, 1)).bounds[0])


def axes_of(quat: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of a quaternion w x y z."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat)
    return matrix.reshape(3, 3)


def centre_on_face(model: mujoco.MjModel, wrench: np.ndarray) -> np.ndarray:
    """Return where the line of a force crosses the peg's face, in the frame of the tip, m."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    tip, sensor = data.site("tip"), data.site("wrist_sensor")
    frame = tip.xmat.reshape(3, 3).T @ sensor.xmat.reshape(3, 3)
    lever = tip.xmat.reshape(3, 3).T @ (tip.xpos - sensor.xpos)
    force, torque = frame @ wrench[:3], frame @ wrench[3:]
    torque = torque - np.cross(lever, force)
    return np.array([-torque[1], torque[0]]) / force[2]


if __name__ == "__main__":
    process_setup.configure()
    main(sys.argv[1:])
