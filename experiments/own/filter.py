"""A filter of one's own: particles, which also learn from the failure itself where the hole is not.

python experiments/own/filter.py [TRIALS]
"""

import sys
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from mjx_fit import resources, runtime
from mjx_fit.evaluation.insertion import ATTEMPTS, draw_holes
from mjx_fit.evaluation.statistics import bootstrap_mean
from mjx_fit.filters.kalman import gaussian_nll
from mjx_fit.simulate.select import make_engine
from mjx_fit.task import hole, learning
from mjx_fit.task.methods import HoleMethod
from mjx_fit.training.checkpoint import load_sensor


def particle_filter(config, sensor):
    """Importance sampling; where a peg would have gone in, by ``task.success_by_error``, is less likely."""
    knots, rates = jnp.asarray(config.task.error_knots_m), jnp.asarray(config.task.success_by_error)

    def one(belief, seen, done, key):
        x = jax.random.multivariate_normal(key, belief.pos_mean_world, belief.pos_cov, (2000,))
        start = done.estimate_world
        gone_in = jnp.interp(jnp.linalg.norm(x - start, axis=1), knots, rates[done.peg_type])
        logw = jnp.log1p(-gone_in) - gaussian_nll(x, start + seen.innovation, seen.pos_noise_cov)
        w = jax.nn.softmax(logw)
        mean = w @ x
        cov = jnp.einsum("n,ni,nj->ij", w, x - mean, x - mean) + 1e-9 * jnp.eye(2)
        learned, failed = replace(belief, pos_mean_world=mean, pos_cov=cov), done.valid & ~done.inserted
        return jax.tree.map(lambda new, old: jnp.where(failed, new, old), learned, belief)

    @jax.jit
    def update(beliefs, done, keys):
        noise, draws = jax.vmap(jax.random.split, out_axes=1)(keys)
        return jax.vmap(one)(beliefs, sensor(learning.readings(done, noise, config)), done, draws)

    return update


def main(trials: int) -> None:
    """Matched holes, the same for both filters: attempts until the peg is in."""
    sensor, config = load_sensor(resources.folder("weights"))
    updates = {"Kalman": learning.filter_update(config, sensor), "particles": particle_filter(config, sensor)}
    holes, methods = draw_holes(config, np.arange(trials), 1, 0), tuple(map(HoleMethod, updates))
    table = hole.HoleTable(config, methods, holes, ATTEMPTS)
    for _ in hole.rounds(table, make_engine("auto", config), hole.update_of_rows(methods, updates)):
        pass
    for name, outcome in table.outcomes().items():
        mean, low, high = bootstrap_mean(outcome.attempts, range(trials))
        print(f"{name}: {mean:.2f} attempts ({low:.2f} to {high:.2f}), n = {trials}")


if __name__ == "__main__":
    runtime.configure()
    main(int(sys.argv[1]) if sys.argv[1:] else 150)
