"""A low-level policy of one's own: a raster in the place of the paper's spiral.

    python experiments/own/policy.py [TRIALS]

A policy gives a command from what it sees, and from what it knew at the start. It runs inside the engine's
compiled controller, so it is written in JAX. One that remembers is a ``Policy(init, act)`` with a state.
"""

import sys

import jax.numpy as jnp
import numpy as np

from mjx_fit import granted, policies, runtime
from mjx_fit.config import Config
from mjx_fit.dataset.draws import draw_attempts
from mjx_fit.evaluation.statistics import wilson
from mjx_fit.randomness import root_key
from mjx_fit.simulate.native import NativeEngine

LINES, REACH_M, PUSH_M = 5, 0.015, 0.004


def raster(seen):
    """Sweeps to and fro along x, line by line in y, pressed on the plate."""
    line, along = jnp.divmod(seen.step / seen.horizon * LINES, 1.0)
    x = REACH_M * (2 * along - 1) * jnp.where(line % 2 == 0, 1, -1)
    y = REACH_M * (2 * line / (LINES - 1) - 1)
    goal = seen.start.estimate_world + jnp.array([x, y])
    return jnp.append(goal - seen.tip_pos_world[:2], -PUSH_M)


def main(trials: int) -> None:
    """Matched attempts, the same holes and detections for both policies."""
    config = Config()
    drawn = draw_attempts(root_key(0, "own policy"), jnp.arange(2 * trials), "spiral", config)
    for name, policy in (("spiral", None), ("raster", policies.stateless(raster))):
        engine = NativeEngine(config, granted.cpus(), policy)
        matched = np.asarray(drawn.peg_type == drawn.hole_type)
        done = engine.run(drawn, config.task.attempt_actions, matched)
        rate = wilson(int(done.truth.inserted[matched].sum()), int(matched.sum()))
        print(f"{name}: {rate.value:.1%} ({rate.low:.1%} to {rate.high:.1%}) of {matched.sum()} inserted")


if __name__ == "__main__":
    runtime.configure()
    main(int(sys.argv[1]) if sys.argv[1:] else 300)
