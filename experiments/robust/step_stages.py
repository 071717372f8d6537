"""Measure where the time of a physics step goes, in ``home`` and in ``as-2026-11``.

    python experiments/robust/step_stages.py

States of running spirals are stepped once more, one by one, under MuJoCo's own timers, which add some time to
each stage. ``contacts`` and ``iterations`` are means per step.
"""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

import time
from pathlib import Path

import jax
import mujoco
import numpy as np

from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config
from mjx_fit.config.worlds import world_file
from mjx_fit.data.schedule import draw_attempts
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.report import script
from mjx_fit.scene.build import pair_index
from mjx_fit.utils import process_setup

WORLDS = ("as-2026-11", "home")
ATTEMPTS, ACTIONS, EVERY = 64, 40, 7
STATE = mujoco.mjtState.mjSTATE_INTEGRATION
TIMER = mujoco.mjtTimer
STAGES = {
    "step": TIMER.mjTIMER_STEP,
    "collision": TIMER.mjTIMER_POS_COLLISION,
    "constraints": TIMER.mjTIMER_POS_MAKE,
    "solver": TIMER.mjTIMER_CONSTRAINT,
}


def main() -> None:
    script.save(
        Path(__file__).with_suffix(".json"),
        stages({world: read_config(world_file(world)) for world in WORLDS}),
    )


def stages(configs: dict[str, Config]) -> dict[str, dict[str, object]]:
    """Return the time of each stage of a physics step, for each configuration."""
    states = {name: _states(config) for name, config in configs.items()}
    mujoco.set_mjcb_time(time.perf_counter)  # only now: batches accept no callback in Python
    return {name: _timed(*found) for name, found in states.items()}


def _states(config: Config) -> tuple[list[mujoco.MjModel], list[np.ndarray]]:
    """Return the models of the attempts, and the states of all of them at every few steps."""
    attempts = draw_attempts(jax.random.key(0), np.arange(ATTEMPTS), policy="spiral", config=config)
    engine = NativeEngine(config, threads=1, on_step=lambda ids, batch: look(batch))
    pair = np.asarray(pair_index(attempts.peg_type, attempts.hole_type, engine.scene.n_types))
    models = [engine.scene.models[i] for i in pair]
    data, steps, states = mujoco.MjData(models[0]), 0, []

    def look(batch) -> None:
        nonlocal steps
        steps += 1
        if steps % EVERY:
            return
        seen = np.empty((ATTEMPTS, mujoco.mj_stateSize(models[0], STATE)))
        for i in range(ATTEMPTS):
            batch.get_data(i, data)
            mujoco.mj_getState(models[i], data, seen[i], STATE)
        states.append(seen)

    engine.run(attempts, ACTIONS)
    return models, states


def _timed(models: list[mujoco.MjModel], states: list[np.ndarray]) -> dict[str, object]:
    spent = dict.fromkeys(STAGES, 0.0)
    contacts, iterations = [], []
    for i, model in enumerate(models):
        data = mujoco.MjData(model)
        for seen in states:
            mujoco.mj_setState(model, data, seen[i], STATE)
            mujoco.mj_step(model, data)
            contacts.append(data.ncon)
            iterations.append(data.solver_niter[0])
        spent = {name: spent[name] + data.timer[int(timer)].duration for name, timer in STAGES.items()}
    return {
        "steps": len(contacts),
        "contacts": round(float(np.mean(contacts)), 2),
        "iterations": round(float(np.mean(iterations)), 2),
        "us": {name: round(1e6 * value / len(contacts), 2) for name, value in spent.items()},
    }


if __name__ == "__main__":
    process_setup.configure()
    main()
