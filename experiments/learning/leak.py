"""Check that the sensor uses only its measurements: exchange them and test for remaining information.

    python experiments/learning/leak.py TRAINING TEST RUN OUT.json     spiral data, the run, the result

The readings have the errors of TEST's world, in training too.

Each attempt keeps its estimate, hole, peg and commanded path; wrench, contact, height, orientation,
velocities and tracking lag come from another attempt. The result must contain no information about the hole.

``exchanged``: the run's sensor on such attempts. Its error is not informative, since it confidently reports
the other attempt's hole. The measure is the share of the truth's variance that the best linear map of its
output explains, cross-validated in two halves. ``retrained``: a sensor of the same kind, trained on such
attempts from the start: its error, and the reduction from the prior's error, paired by attempt. ``control``:
the same training on the original attempts.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import shared
from jaxtyping import Float

from mjx_fit.config.schema import Config, config_from_stored, config_from_tree, config_to_tree
from mjx_fit.data.episode import Episode
from mjx_fit.data.manifest import read_manifest
from mjx_fit.evaluation import held_out
from mjx_fit.report import script
from mjx_fit.training.checkpoint import load_sensor
from mjx_fit.training.loop import train
from mjx_fit.training.run import Run
from mjx_fit.types import Array, Trace
from mjx_fit.utils import process_setup

EPOCHS = 20
RESAMPLES = 1000


def main(training: Path, test: Path, run: Path, out: Path) -> None:
    train_as_is, test_as_is = shared.first_attempts(training), shared.first_attempts(test)
    train_exchanged, test_exchanged = (exchanged(data, seed=7) for data in (train_as_is, test_as_is))
    sensor, of_run = load_sensor(run)
    stored = config_from_stored(read_manifest(test).request["config"])
    config = replace(stored, sensor=of_run.sensor, train=of_run.train)
    results = {
        "n_training": len(train_as_is.episode),
        "n": len(test_as_is.episode),
        "prior_error_cm": shared.mean_of(np.linalg.norm(_offset(test_as_is), axis=1)),
        "explained_by_the_run": {
            name: explained(_said(sensor, data, config), _offset(data))
            for name, data in (("as it was", test_as_is), ("exchanged", test_exchanged))
        },
    }
    tree = config_to_tree(config)
    tree["train"] |= {"epochs": EPOCHS, "sequence": 1, "min_window": 20}
    config = config_from_tree(tree)
    for name, data, judged in (
        ("control", train_as_is, test_as_is),
        ("retrained", train_exchanged, test_exchanged),
    ):
        with tempfile.TemporaryDirectory() as folder:
            train(data, config, Run(Path(folder) / "run", seed=0))
            trained, _ = load_sensor(Path(folder) / "run")
        error = _errors(trained, judged, config)
        prior = np.linalg.norm(_offset(judged), axis=1)
        results[name] = {"error_cm": shared.mean_of(error), "gain_cm": shared.mean_of(prior - error)}
    script.save(out, results)


def exchanged(data: Episode, seed: int) -> Episode:
    """Exchange measurements: in a random order each attempt gets those of its predecessor."""
    n = len(data.episode)
    order = np.random.default_rng(seed).permutation(n)
    other = np.empty(n, int)
    other[order] = np.roll(order, 1)
    rollout = data.rollout
    trace, felt = rollout.felt.trace, jax.tree.map(lambda leaf: leaf[other], rollout.felt.trace)
    origin = rollout.felt.estimate_world[:, None]
    goal = _goal(rollout.felt.trace, rollout.felt.estimate_world)
    lag = (
        felt.tip_pos_world[..., :2]
        - rollout.felt.estimate_world[other][:, None]
        - _goal(felt, rollout.felt.estimate_world[other])
    )
    tip = np.concatenate([origin + goal + lag, felt.tip_pos_world[..., 2:]], axis=-1)
    before = np.concatenate([np.zeros_like(goal[:, :1]), (goal + lag)[:, :-1]], axis=1)
    action = np.concatenate([goal - before, felt.action_world[..., 2:]], axis=-1)
    trace = replace(felt, tip_pos_world=tip, action_world=action)
    tare = rollout.felt.tare_sensor[other]
    return replace(data, rollout=replace(rollout, felt=replace(rollout.felt, trace=trace, tare_sensor=tare)))


def _goal(trace: Trace, estimate: Array) -> Float[np.ndarray, "n J 2"]:
    """Compute the commanded TCP position of each action, relative to the estimate (the start)."""
    at = trace.tip_pos_world[..., :2] - estimate[:, None]
    before = np.concatenate([np.zeros_like(at[:, :1]), at[:, :-1]], axis=1)
    return before + trace.action_world[..., :2]


def explained(said: Float[np.ndarray, "n 2"], truth: Float[np.ndarray, "n 2"]) -> dict[str, float]:
    """Compute the share of the truth's variance that a linear map of the output explains, cross-validated."""
    n = len(said)
    half = np.random.default_rng(1).permutation(n) % 2 == 0
    columns = np.concatenate([said, np.ones((n, 1))], axis=1)
    left = np.zeros_like(truth)
    for fit, judge in ((half, ~half), (~half, half)):
        weights, *_ = np.linalg.lstsq(columns[fit], truth[fit], rcond=None)
        left[judge] = truth[judge] - columns[judge] @ weights
    squared, total = np.square(left).sum(1), np.square(truth - truth.mean(0)).sum(1)
    rng = np.random.default_rng(0)
    drawn = rng.integers(n, size=(RESAMPLES, n))
    shares = 1 - squared[drawn].mean(1) / total[drawn].mean(1)
    low, high = np.quantile(shares, [0.025, 0.975])
    return {"value": 1 - squared.mean() / total.mean(), "low": low, "high": high}


def _offset(data: Episode) -> Float[np.ndarray, "n 2"]:
    """Compute the offset of the hole from the estimate, cm."""
    return 100 * np.asarray(data.rollout.truth.hole_pos_world - data.rollout.felt.estimate_world, float)


def _said(sensor, data: Episode, config: Config) -> Float[np.ndarray, "n 2"]:
    ids = np.arange(len(data.episode))
    return 100 * np.asarray(held_out.observe(sensor, data, ids, shared.ACTIONS, config, seed=0).innovation)


def _errors(sensor, data: Episode, config: Config) -> Float[np.ndarray, " n"]:
    ids = np.arange(len(data.episode))
    seen = held_out.observe(sensor, data, ids, shared.ACTIONS, config, seed=0)
    after = held_out.posterior(seen, data, ids, config, with_prior=True)
    return np.array(
        [row["error_cm"] for row in held_out.rows("full", shared.ACTIONS, after, data, ids, config)]
    )


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(f"usage: python {sys.argv[0]} TRAINING TEST RUN OUT.json")
    process_setup.configure()
    main(*map(Path, sys.argv[1:]))
