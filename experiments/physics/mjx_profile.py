"""Profile MJX on a CPU: the same presses on the plate, with stages replaced by MJX's own or left out.

    python experiments/physics/mjx_profile.py

Results are microseconds of one thread per world and step, with 128 worlds, so that they include no waiting or
dispatch.
"""

# pyright: reportAttributeAccessIssue=false
import time
from types import SimpleNamespace
from unittest.mock import patch

import jax
import jax.numpy as jnp
import shared
from mujoco import mjx

from mjx_fit.cli.bench.engines import attempts_of
from mjx_fit.config.schema import Config
from mjx_fit.control import operational_space
from mjx_fit.control.kinematics import chain_of
from mjx_fit.engines.attempt_rules import start_qpos
from mjx_fit.engines.mjx import contact, step
from mjx_fit.engines.mjx.compiler import compiler_options
from mjx_fit.engines.mjx.step import Models, arm_state, placed
from mjx_fit.scene.build import pair_index, simulation_scene
from mjx_fit.utils.linalg import worlds_last

WORLDS, STEPS = 128, 100


def main() -> None:
    """Time every variant."""
    nothing = {"collide": lambda model, data: data, "solve": _free}
    variants = {
        "as it is": ({}, True),
        "no controller": ({}, False),
        "neither contacts nor controller": (nothing, False),
        "MJX's collision": ({"collide": mjx.collision}, True),
        "MJX's solver and integrator": ({"solve": _mjx_solve, "integrate": mjx.implicit}, True),
        "both of MJX": ({"collide": mjx.collision, "solve": _mjx_solve, "integrate": mjx.implicit}, True),
    }
    rows = {}
    for name, (changed, controlled) in variants.items():
        ours = {stage: getattr(contact, stage) for stage in ("collide", "solve", "integrate")}
        with patch.object(step, "contact", SimpleNamespace(**ours | changed)):
            rows[name] = _microseconds(controlled)
        print(f"{name}: {rows[name]:.1f}", flush=True)
    shared.save("mjx_profile", {"worlds": WORLDS, "us_per_world_and_step": rows})


def _mjx_solve(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """Solve with 8 line-search steps, which are enough: MJX always runs all of them."""
    model = model.replace(opt=model.opt.replace(ls_iterations=8))
    return mjx.solve(model, mjx.fwd_acceleration(model, mjx.factor_m(model, data)))


def _free(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """Finish a step in free space, without the accelerations, which no later stage needs."""
    return data.replace(qfrc_constraint=0 * data.qfrc_smooth)


def _microseconds(controlled: bool) -> float:
    config = Config()
    scene = simulation_scene(config.scene)
    attempts = attempts_of(config, WORLDS)
    pair = pair_index(attempts.peg_type, attempts.hole_type, scene.n_types)
    models, axes = Models.of(scene).of_worlds(pair)
    gains = operational_space.gains_of(config)

    def world(model, qpos, hole, goal):
        data = placed(model, qpos, hole, scene.plate_top_m)
        to = jnp.append(goal, scene.plate_top_m - config.spiral.push_m)
        command = worlds_last(lambda arm, goal: operational_space.torque(arm, goal, gains))

        def step(data, _):
            arm = arm_state(model, data, scene)
            # Without the controller: gravity compensation, damping, and a torque that presses the peg down.
            free = data.qfrc_bias - 5 * data.qvel + jnp.array([0, 8.0, 0, 0, 0, 0, 0])
            torque = command(arm, to) if controlled else free
            return step.advance(model, data, torque)

        return jax.lax.scan(step, data, length=STEPS)[1]

    rollout = jax.jit(jax.vmap(world, (axes, 0, 0, 0)), compiler_options=compiler_options())
    qpos = start_qpos(chain_of(scene.models[0]), attempts, config)
    fields = models, qpos, attempts.hole_pos_world, attempts.estimate_world
    jax.block_until_ready(rollout(*fields))
    seconds = []
    for _ in range(3):
        began = time.perf_counter()
        jax.block_until_ready(rollout(*fields))
        seconds.append(time.perf_counter() - began)
    return 1e6 * min(seconds) / WORLDS / STEPS


if __name__ == "__main__":
    shared.begin()
    main()
