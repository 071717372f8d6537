"""Where does MJX's time go on a CPU? The same presses on the plate with parts of the work left out.

    python experiments/physics/mjx_profile.py

Microseconds of one thread per world and step, 128 worlds, so that nothing of it is waiting or dispatch.
"""

# pyright: reportAttributeAccessIssue=false
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import mujoco
import shared

from mjx_fit import control
from mjx_fit.bench.engines import attempts_of
from mjx_fit.config import Config
from mjx_fit.kinematics import chain_of
from mjx_fit.scene import pair_index, simulation_scene
from mjx_fit.simulate.engine import start_qpos
from mjx_fit.simulate.mjx import arm_state, compiler_options
from mjx_fit.simulate.stages import advance, models_of, placed, stacked_models

WORLDS, STEPS = 128, 100


def main() -> None:
    """Times every variant."""
    variants: dict[str, tuple[Callable[[mujoco.MjModel], None], bool]] = {
        "as it is: 18 candidate pairs of boxes, 8 Newton iterations": (lambda model: None, True),
        "no controller": (lambda model: None, False),
        "4 candidate pairs": (_four_pairs, True),
        "1 Newton iteration": (_one_iteration, True),
        "4 candidate pairs and 1 Newton iteration": (_both, True),
    }
    rows = {}
    for name, (edit, controlled) in variants.items():
        rows[name] = _microseconds(edit, controlled)
        print(f"{name}: {rows[name]:.1f}", flush=True)
    shared.save("mjx_profile", {"worlds": WORLDS, "us_per_world_and_step": rows})


def _microseconds(edit: Callable[[mujoco.MjModel], None], controlled: bool) -> float:
    config = Config()
    scene = simulation_scene(config.scene)
    for model in scene.models:
        edit(model)
    stacked, axes = stacked_models(scene)
    attempts = attempts_of(config, WORLDS)
    models = models_of(stacked, pair_index(attempts.peg_type, attempts.hole_type))

    def world(model, qpos, hole, goal):
        data = placed(model, qpos, hole, scene.plate_top_m)
        to = jnp.append(goal, scene.plate_top_m - config.spiral.push_m)

        def step(data, _):
            arm = arm_state(model, data, scene)
            # Without the controller: gravity, some damping, and a pull that presses the peg on the plate.
            free = data.qfrc_bias - 5 * data.qvel + jnp.array([0, 8.0, 0, 0, 0, 0, 0])
            torque = control.torque(arm, to, config.control) if controlled else free
            return advance(model, data, torque)

        return jax.lax.scan(step, data, length=STEPS)[1]

    rollout = jax.jit(jax.vmap(world, (axes, 0, 0, 0)), compiler_options=compiler_options())
    qpos = start_qpos(chain_of(scene.models[0]), attempts, scene)
    fields = models, qpos, attempts.hole_pos_world, attempts.estimate_world
    jax.block_until_ready(rollout(*fields))
    seconds = []
    for _ in range(3):
        began = time.perf_counter()
        jax.block_until_ready(rollout(*fields))
        seconds.append(time.perf_counter() - began)
    return 1e6 * min(seconds) / WORLDS / STEPS


def _one_iteration(model: mujoco.MjModel) -> None:
    model.opt.iterations = 1


def _four_pairs(model: mujoco.MjModel) -> None:
    """Leaves one box of the peg and four walls, as for a square in a square."""
    for name in ("peg_box1", "hole_box0", *(f"hole_box{i}" for i in range(5, 9))):
        model.geom(name).contype, model.geom(name).conaffinity = 0, 0


def _both(model: mujoco.MjModel) -> None:
    _four_pairs(model)
    _one_iteration(model)


if __name__ == "__main__":
    shared.begin()
    main()
