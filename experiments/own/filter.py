"""Use your own filter: a particle filter that also learns from the failure itself where the hole is not.

python experiments/own/filter.py [TRIALS]
"""

import sys
from dataclasses import replace

import jax
import jax.numpy as jnp
from jax.scipy.stats import multivariate_normal

import mjx_fit as mf


def particle_filter(config: mf.Config, sensor):
    """Weight samples; positions where ``task.success_by_error`` predicts success are less likely."""
    knots, rates = jnp.asarray(config.task.error_knots_m), jnp.asarray(config.task.success_by_error)

    def one(belief, seen, felt, key):
        x = jax.random.multivariate_normal(key, belief.pos_mean_world, belief.pos_cov, (2000,))
        start = felt.estimate_world
        gone_in = jnp.interp(jnp.linalg.norm(x - start, axis=1), knots, rates[felt.peg_type])
        likelihood = multivariate_normal.logpdf(x, start + seen.innovation, seen.pos_noise_cov)
        w = jax.nn.softmax(jnp.log1p(-gone_in) + likelihood)
        mean = w @ x
        cov = jnp.einsum("n,ni,nj->ij", w, x - mean, x - mean) + 1e-9 * jnp.eye(2)
        return replace(belief, mean_world=mean, cov=cov)

    @jax.jit
    def update(beliefs, felt, keys):
        noise, draws = jax.vmap(jax.random.split, out_axes=1)(keys)
        return jax.vmap(one)(beliefs, sensor(mf.readings(felt, noise, config)), felt, draws)

    return update


def main(trials: int) -> None:
    """Count attempts until insertion at the same matched holes for both filters."""
    trained = mf.load_sensor()
    config, sensor = trained.config, trained.network
    updates = {"Kalman": mf.filter_update(config, sensor), "particles": particle_filter(config, sensor)}
    for name, outcome in mf.try_holes(mf.draw_holes(0, trials, config), updates, config).items():
        mean, low, high = mf.mean_interval(outcome.attempts)
        print(f"{name}: {mean:.2f} attempts ({low:.2f} to {high:.2f}), n = {trials}")


if __name__ == "__main__":
    mf.configure()
    main(int(sys.argv[1]) if sys.argv[1:] else 150)
