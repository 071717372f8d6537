"""Profile the native engine: the same steps of the same worlds, with more and more of the engine added.

    python experiments/physics/native_profile.py

Results are microseconds of one thread per world and step, with 128 worlds.
"""

# pyright: reportAttributeAccessIssue=false
import time
from collections.abc import Callable

import jax
import numpy as np
import shared
from mujoco.batch import Batch

from mjx_fit.cli.bench.engines import attempts_of
from mjx_fit.config.schema import Config
from mjx_fit.engines.native.block import Block, Layout, batch_at_rest
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.engines.native.models import Models
from mjx_fit.scene.placement import setting_of
from mjx_fit.utils.rates import SUBSTEPS

WORLDS, ACTIONS, TIMES = 128, 10, 5
STEPS = ACTIONS * SUBSTEPS


def main() -> None:
    """Time the variants in turn, so that a slow period affects all of them."""
    config = shared.config()
    attempts = attempts_of(config, WORLDS)
    torque, start = _recorded(config)
    engine = NativeEngine(config, 1)
    models = Models(engine.scene)
    setting = setting_of(attempts.hole_pos_world, attempts.physics, config)
    block = Block(models, Layout(engine.scene), attempts, setting, start, WORLDS)
    goal = np.asarray(block.tip_pos_world + np.array([0, 0, -0.004]), np.float32)

    def alone() -> None:
        batch_at_rest(models, attempts, setting, start, 1).rollout(STEPS, torque, record=("sensordata",))

    def in_turns() -> None:
        block.move(start, np.zeros_like(start))
        for step in range(STEPS):
            block.step(torque[:, step], step % SUBSTEPS)

    def control() -> None:
        packed = block.packed()
        for _ in range(STEPS):
            np.asarray(engine._torque(packed, goal))

    def packing() -> None:
        for _ in range(STEPS):
            block.packed()

    variants: dict[str, Callable[[], object]] = {
        "C alone, all steps of one world and then the next": alone,
        "C and the trace, the worlds in turns": in_turns,
        "the controller alone": control,
        "its inputs alone": packing,
        "everything": lambda: engine.run(attempts, ACTIONS),
    }
    seconds: dict[str, list[float]] = {name: [] for name in variants}
    for _ in range(TIMES + 1):  # the first compiles
        for name, run in variants.items():
            began = time.perf_counter()
            run()
            seconds[name].append(time.perf_counter() - began)
    rows = {name: 1e6 * float(np.median(values[1:])) / (WORLDS * STEPS) for name, values in seconds.items()}
    shared.save("native_profile", {"worlds": WORLDS, "us_per_world_and_step": rows})


def _recorded(config: Config) -> tuple[np.ndarray, np.ndarray]:
    """Return the torques (n, steps, 7) that the engine applies and the initial joint angles (n, 7)."""
    torque, step = np.zeros((WORLDS, STEPS, 7)), np.zeros(WORLDS, int)

    def record(ids: np.ndarray, batch: Batch) -> None:
        torque[ids, step[ids]] = batch.bind("ctrl")
        step[ids] += 1

    engine = NativeEngine(config, 1, on_step=record)
    attempts = attempts_of(config, WORLDS)
    assert (engine.run(attempts, ACTIONS).length == ACTIONS).all()  # no attempt ends early
    return torque, np.asarray(jax.device_get(engine._start(attempts=attempts)))


if __name__ == "__main__":
    shared.begin()
    main()
