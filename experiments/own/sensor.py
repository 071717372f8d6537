"""Use your own sensor: a linear fit, made in a second and better than no sensor.

    python experiments/own/sensor.py DATA TEST

``mjx-fit collect`` makes DATA with ``--seed 0`` and TEST with ``--seed 1``.
A position sensor is any function that returns an innovation and its covariance; the Kalman filter does
the rest.
"""

import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import mjx_fit as mf

RIDGE = 10.0


def features(felt: mf.Felt) -> np.ndarray:
    """Compute how force and centre of pressure vary with the TCP position, averaged over each trace."""
    n = len(felt.length)
    seen = mf.readings(felt, jax.random.split(jax.random.key(0), n), mf.Config())
    one, tip = jnp.ones((*seen.mask.shape, 1)), 100 * seen.tip_pos_estimate
    pressed = jnp.concatenate([seen.wrench_sensor.mean(2), 100 * seen.pressure_tip, one], -1)
    where = jnp.concatenate([tip, tip**2, one], -1)
    share = seen.mask / seen.mask.sum(1)[:, None]
    return np.asarray(jnp.einsum("nji,njk,nj->nik", pressed, where, share), float).reshape(n, -1)


def main(data: Path, test: Path) -> None:
    """Fit on the failed attempts of one set and update the prior with those of the other."""
    sides = []
    for folder in (data, test):
        episodes = mf.load_dataset(folder)
        keep = np.asarray(episodes.rollout.truth.failed & (episodes.number == 0))
        failed = episodes.rollout[keep]
        offset = np.asarray(failed.truth.hole_pos_world - failed.felt.estimate_world, float)
        sides.append((features(failed.felt), offset, jnp.asarray(episodes.estimate_cov[keep])))
    (x, y, _), (x_test, y_test, prior) = sides
    x, x_test = (rows / (x.std(0) + 1e-9) for rows in (x, x_test))
    weights = np.linalg.solve(x.T @ x + RIDGE * np.eye(x.shape[1]), x.T @ y)
    noise = jnp.broadcast_to(jnp.cov((y - x @ weights).T), prior.shape)
    mean, _ = mf.kalman_update(jnp.zeros(y_test.shape), prior, jnp.asarray(x_test @ weights), noise)
    for name, error in (("nothing", y_test), ("linear sensor", y_test - np.asarray(mean))):
        print(f"{name}: {100 * np.linalg.norm(error, axis=1).mean():.3f} cm off, n = {len(y_test)}")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        raise SystemExit(__doc__)
    mf.configure()
    main(*map(Path, sys.argv[1:3]))
