"""Use your own low-level policy: a raster instead of the paper's spiral.

    python experiments/own/policy.py [TRIALS]

A policy computes a command from its current input and the start conditions. It runs inside the engine's
compiled controller, so it is written in JAX. A policy with memory is a ``Policy(init, act)`` with a state.
"""

import sys

import jax
import jax.numpy as jnp
import numpy as np

import mjx_fit as mf

LINES, REACH_M, PUSH_M = 5, 0.015, 0.004


def raster(seen: mf.PolicyInput) -> jax.Array:
    """Sweep back and forth along x, line by line in y, pressed on the plate."""
    line, along = jnp.divmod(seen.step / seen.horizon * LINES, 1.0)
    x = REACH_M * (2 * along - 1) * jnp.where(line % 2 == 0, 1, -1)
    y = REACH_M * (2 * line / (LINES - 1) - 1)
    goal = seen.start.estimate_world + jnp.array([x, y])
    return jnp.append(goal - seen.tip_pos_world[:2], -PUSH_M)


def main(trials: int) -> None:
    """Run matched attempts with the same holes and detections for both policies."""
    drawn = mf.draw_attempts(jax.random.key(0), 2 * trials)
    matched = np.asarray(drawn.peg_type == drawn.hole_type)
    for name, policy in (("spiral", None), ("raster", mf.stateless_policy(raster))):
        done = mf.make_engine("native", policy=policy).run(drawn, active=matched)
        mean, low, high = mf.mean_interval(np.asarray(done.truth.inserted)[matched])
        print(f"{name}: {mean:.1%} ({low:.1%} to {high:.1%}) of {matched.sum()} inserted")


if __name__ == "__main__":
    mf.configure()
    main(int(sys.argv[1]) if sys.argv[1:] else 300)
