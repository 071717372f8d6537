"""Reproduce the hang in isolation: batched LAPACK calls in loops that XLA:CPU runs in parallel.

    python experiments/physics/deadlock.py

Two host threads each run a computation of three independent loops, and XLA runs the loops on its thread pool,
one thread per core. Each loop factorises a batch of 7 x 7 matrices by Cholesky (LAPACK's potrf). A large
batch is distributed over that same pool, and the calling thread waits for it. Once every thread of the pool
waits, no thread is left to do the work. Neither MuJoCo nor our engines are involved.
"""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import shared

from mjx_fit.engines.threads import on_threads

BATCHES = (256, 512, 1024, 1400, 2048, 4096)
LOOPS, ITERATIONS, TIMES = 3, 200, 5
LIMIT_S = 60
"""Time limit of a batch; a batch of 4,096 takes about ten seconds if it finishes."""


def main() -> None:
    """Run each batch in its own process and report which ones finished."""
    ended = {}
    for batch in BATCHES:
        try:
            subprocess.run([sys.executable, __file__, str(batch)], timeout=LIMIT_S, check=True)
            ended[str(batch)] = True
        except subprocess.TimeoutExpired:
            ended[str(batch)] = False
        print(batch, "finished" if ended[str(batch)] else "hung", flush=True)
    shared.save("deadlock", {"limit_s": LIMIT_S, "came_to_an_end": ended})


def work(batch: int) -> None:
    """Run the loops."""
    identity = 3 * np.eye(7, dtype=np.float32)

    def step(x, _):
        matrix = identity + 1e-3 * x[:, None] * x
        return jnp.tanh(jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(matrix), x)) + 1, None

    def loop(x):
        return jax.lax.scan(step, x, length=ITERATIONS)[0]

    starts = [np.full((batch, 7), i + 1, np.float32) for i in range(LOOPS)]
    loops = jax.jit(lambda xs: [jax.vmap(loop)(x) for x in xs]).lower(starts).compile()
    for _ in range(TIMES):
        on_threads(2, lambda xs: jax.block_until_ready(loops(xs)), [starts, starts])


if __name__ == "__main__":
    main() if len(sys.argv) == 1 else work(int(sys.argv[1]))
