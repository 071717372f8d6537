"""Compare one step of MJX with C MuJoCo.

    python experiments/physics/parity_step.py

The script evaluates the dynamics once from the same states in both engines. Free states are random; states in
contact come from spiral and random attempts in the C engine.
"""

# pyright: reportAttributeAccessIssue=false

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import shared
from mujoco import mjx

from mjx_fit.config.schema import Config
from mjx_fit.data.schedule import draw_attempts
from mjx_fit.engines.mjx.compiler import compiler_options
from mjx_fit.engines.mjx.step import Models, accelerate, observe
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.scene.build import Scene, pair_index, simulation_scene

FREE = 216
STEPS_BETWEEN = 170


def main() -> None:
    """Compare smooth dynamics, accelerations and sensor readings from free states and states in contact."""
    config = shared.config()
    scene = simulation_scene(config.scene)
    free, touching = _free_states(scene), _contact_states(config)
    results: dict = {"free_states": FREE, "contact_states": len(touching["pair"])}
    for name, states in (("free", free), ("contact", touching)):
        in_c, in_mjx = _in_c(scene, states), _in_mjx(scene, states)
        results[name] = {
            what: shared.quantiles(_relative(in_mjx[what], in_c[what]), (0.5, 0.75, 0.9, 1))
            for what in ("qacc_smooth", "qacc")
        }
        wrench = in_mjx["sensordata"] - in_c["sensordata"]
        for what, columns in (("force_error_n", slice(3)), ("torque_error_nm", slice(3, 6))):
            error = np.linalg.norm(wrench[:, columns], axis=1)
            results[name][what] = shared.quantiles(error, (0.5, 0.75, 0.9, 1))
        results[name]["force_n"] = shared.quantiles(
            np.linalg.norm(in_c["sensordata"][:, :3], axis=1), (0.5, 0.9)
        )
        if name == "contact":
            same = in_mjx["points"] == in_c["points"]
            results[name]["states_with_equal_contact_points"] = float(same.mean())
            results[name]["qacc_where_they_are_equal"] = shared.quantiles(
                _relative(in_mjx["qacc"], in_c["qacc"])[same], (0.5, 0.75, 0.9, 1)
            )
            results[name]["share_of_edge_on_edge_in_c"] = in_c["edges"].sum() / in_c["slots"].sum()
            results[name]["qacc_without_edges"] = shared.quantiles(
                _relative(in_mjx["qacc"], in_c["qacc"])[in_c["edges"] == 0], (0.5, 0.75, 0.9, 1)
            )
            results[name]["mean_contacts"] = {"c": in_c["slots"].mean(), "mjx": in_mjx["slots"].mean()}
            results[name]["mean_distinct_contacts"] = {
                "c": in_c["points"].mean(),
                "mjx": in_mjx["points"].mean(),
            }
    smooth = max(results[name]["qacc_smooth"]["max"] for name in ("free", "contact"))
    results["holds"] = {"smooth_within_1e-4": smooth < 1e-4}
    shared.save("parity_step", results)


def _free_states(scene: Scene) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    low, high = scene.models[0].jnt_range.T
    return {
        "pair": np.arange(FREE) % 9,
        "qpos": rng.uniform(0.9 * low, 0.9 * high, (FREE, 7)),
        "qvel": rng.normal(0, 0.5, (FREE, 7)),
        "qacc_warmstart": np.zeros((FREE, 7)),
        "ctrl": rng.normal(0, 10, (FREE, 7)),
        "mocap_pos": np.tile([0, 5, -5], (FREE, 1)),
    }


def _contact_states(config: Config) -> dict[str, np.ndarray]:
    """Sample states in contact from attempts, every ``STEPS_BETWEEN`` steps."""
    n = 90
    attempts = draw_attempts(jax.random.key(3), jnp.arange(n), "mixed", config)
    pair = np.asarray(pair_index(attempts.peg_type, attempts.hole_type, config.scene.n_types))
    names = ("qpos", "qvel", "qacc_warmstart", "ctrl", "mocap_pos")
    kept: dict[str, list] = {name: [] for name in ("pair", *names)}
    step = np.zeros(n, int)

    def look(ids: np.ndarray, batch) -> None:
        step[ids] += 1
        if step[ids[0]] % STEPS_BETWEEN == 0:
            touching = np.flatnonzero((batch.bind("qfrc_constraint") != 0).any(1))
            kept["pair"].append(pair[ids[touching]])
            for name in names:
                kept[name].append(batch.bind(name)[touching].reshape(len(touching), -1).copy())

    NativeEngine(config, 1, on_step=look).run(attempts, 60)
    return {name: np.concatenate(parts) for name, parts in kept.items()}


def _in_c(scene: Scene, states: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    rows = []
    for i, pair in enumerate(states["pair"]):
        model = scene.models[pair]
        data = mujoco.MjData(model)
        for name in ("qpos", "qvel", "qacc_warmstart", "ctrl"):
            getattr(data, name)[:] = states[name][i].astype(np.float32)
        data.mocap_pos[0] = states["mocap_pos"][i].astype(np.float32)
        mujoco.mj_forward(model, data)
        touching = data.contact.dist < 0
        points, normals = data.contact.pos[touching], data.contact.frame[touching, :3]
        edges = _of_edges(normals, data.site("tip").xmat.reshape(3, 3))
        rows.append((data.qacc_smooth, data.qacc, data.sensordata, _distinct(points), len(points), edges))
    names = ("qacc_smooth", "qacc", "sensordata", "points", "slots", "edges")
    return {name: np.array([np.array(row[k]) for row in rows]) for k, name in enumerate(names)}


def _in_mjx(scene: Scene, states: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    models, axes = Models.of(scene).of_worlds(states["pair"])

    def one(model, qpos, qvel, qacc_warmstart, ctrl, mocap_pos):
        data = mjx.make_data(model.mjx).replace(qpos=qpos, qvel=qvel, qacc_warmstart=qacc_warmstart)
        data = accelerate(model, observe(model, data.replace(ctrl=ctrl, mocap_pos=mocap_pos[None])))
        return data.qacc_smooth, data.qacc, data.sensordata, data._impl.contact.pos, data._impl.contact.dist

    batched = jax.jit(jax.vmap(one, (axes, 0, 0, 0, 0, 0)), compiler_options=compiler_options())
    fields = [np.asarray(value, np.float32) for name, value in states.items() if name != "pair"]
    smooth, acc, sensor, pos, dist = map(np.asarray, batched(models, *fields))
    touching = [points[deep < 0] for points, deep in zip(pos, dist, strict=True)]
    return {
        "qacc_smooth": smooth,
        "qacc": acc,
        "sensordata": sensor,
        "points": np.array([_distinct(points) for points in touching]),
        "slots": np.array([len(points) for points in touching]),
    }


def _of_edges(normals: np.ndarray, frame: np.ndarray) -> int:
    """Count edge-edge contacts, whose normal matches no face of the peg or the plate."""
    along = np.maximum(np.abs(normals).max(1, initial=0), np.abs(normals @ frame).max(1, initial=0))
    return int((along < 1 - 1e-9).sum())


def _distinct(points: np.ndarray) -> int:
    """Count contact points that are further apart than a hundredth of a millimetre."""
    return len(np.unique(np.round(points, 5), axis=0)) if len(points) else 0


def _relative(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(a - b, axis=1) / np.linalg.norm(b, axis=1)


if __name__ == "__main__":
    shared.begin()
    main()
