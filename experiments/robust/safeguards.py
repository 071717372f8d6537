"""Fit the safeguards of the filters on held-out attempts, and measure each alone.

    python experiments/robust/safeguards.py RUN HOME FORGE

HOME and FORGE are data sets of five consecutive attempts at a hole that start from the posterior of RUN,
collected without safeguards. Their readings are chained again under each setting; only the mismatched holes
count, where all attempts fail.

- ρ: of those whose 90 % ellipse holds 85 to 95 % of the holes after each attempt in both worlds, the one with
  the least negative log-likelihood (mean over attempts and worlds); if there is none, the nearest.
- The temperature is that of the least negative log-likelihood of the match.

All holes serve to fit: ``fitted_on_halves`` shows how far half of them would decide. ``evaluate robustness``
judges the fitted values on other holes. Besides, there is the NEES of single readings by the distance of the
start from the hole.
"""

import itertools
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from mjx_fit.config.schema import Config, config_from_stored
from mjx_fit.config.sections.filter import FilterConfig
from mjx_fit.data import reader
from mjx_fit.data.episode import Episode
from mjx_fit.data.manifest import read_manifest
from mjx_fit.evaluation import held_out
from mjx_fit.evaluation.robustness import run_away
from mjx_fit.evaluation.scores import inside, squared_mahalanobis
from mjx_fit.filters.kalman import CM_PER_M, gaussian_nll
from mjx_fit.filters.updates import NONE, initial_belief, update_position
from mjx_fit.report import script
from mjx_fit.training.sensor_loader import load_trained_sensor
from mjx_fit.types import Array, Observation
from mjx_fit.utils import process_setup

ATTEMPTS = 5
CORRELATIONS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6)
TEMPERATURES = tuple(round(float(t), 2) for t in np.geomspace(0.7, 3, 25))
DISTANCES_MM = (0, 2, 5, 10, 15, 20, 24, 30, 60)
COVERED = (0.85, 0.95)
"""Share of the holes that the 90 % ellipse is to hold, to the percent."""
GATES = (0.9, 0.95, 0.99, 0.999)


@dataclass(frozen=True)
class Chains:
    """Five readings at each of n mismatched holes, and the match logits of m first attempts.

    Attributes:
        seen: Readings (n, 5).
        start_m: Estimates that the attempts started from.
        hole_m: The holes.
        logits: Logits of h_match.
        matches: Whether these pegs match.
    """

    seen: Observation
    start_m: Float[np.ndarray, "n 5 2"]
    hole_m: Float[np.ndarray, "n 2"]
    logits: Float[np.ndarray, "m 2"]
    matches: Bool[np.ndarray, " m"]


@dataclass(frozen=True)
class Scores:
    """Means over holes after each of five attempts, and the number of holes of which the belief runs away."""

    error_mm: list[float]
    coverage_90: list[float]
    nees: list[float]
    nll: list[float]
    runaways: int


def main(run: Path, home: Path, forge: Path) -> None:
    chains = {name: _chains(run, folder) for name, folder in (("home", home), ("forge", forge))}
    config = config_from_stored(read_manifest(home).request["config"])
    losses = {name: _losses(own, config, slice(None)) for name, own in chains.items()}
    fitted = _fitted(losses)
    correlation, temperature = fitted["correlation"], fitted["match_temperature"]
    settings = {
        "none": NONE,
        f"correlation {correlation}": replace(NONE, correlation=correlation),
        **{f"gate {gate}": replace(NONE, gate=gate) for gate in GATES},
        **{
            f"correlation {correlation}, gate {gate}": replace(NONE, gate=gate, correlation=correlation)
            for gate in GATES
        },
    }
    results = {
        "holes": {name: len(own.hole_m) for name, own in chains.items()},
        "fitted": fitted,
        "fitted_on_halves": [
            _fitted({name: _losses(own, config, slice(half, None, 2)) for name, own in chains.items()})
            for half in (0, 1)
        ],
        "losses": losses,
        "scores": {
            name: {label: vars(_scores(own, setting, config)) for label, setting in settings.items()}
            for name, own in chains.items()
        },
        "match_nll": {
            name: {str(t): _match_nll(own, t, slice(None)) for t in (1.0, temperature)}
            for name, own in chains.items()
        },
        "reading_by_distance": {name: _by_distance(own) for name, own in chains.items()},
    }
    script.save(Path(__file__).with_suffix(".json"), results)


def _chains(run: Path, folder: Path) -> Chains:
    sensor, manifest = load_trained_sensor(run), read_manifest(folder)
    config = replace(config_from_stored(manifest.request["config"]), sensor=sensor.config.sensor)
    data = reader.load(folder)
    ids = held_out.failed_attempts(data, config.task.attempt_actions)
    observation = held_out.observe(sensor.network, data, ids, config.task.attempt_actions, config, 0)
    matches = np.asarray(data.rollout.felt.peg_type == data.rollout.truth.hole_type)[ids]
    first = np.asarray(data.number)[ids] == 0
    rows = _of_whole_sequences(data, ids, ~matches)
    at = ids[rows]
    return Chains(
        seen=jax.tree.map(lambda leaf: np.asarray(leaf)[rows], observation),
        start_m=np.asarray(data.rollout.felt.estimate_world)[at],
        hole_m=np.asarray(data.rollout.truth.hole_pos_world)[at[:, 0]],
        logits=np.asarray(observation.match_logits)[first],
        matches=matches[first],
    )


def _of_whole_sequences(data: Episode, ids: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return rows of ``ids``, (n, 5), of the sequences of which all five attempts are wanted."""
    sequence, number = np.asarray(data.sequence)[ids], np.asarray(data.number)[ids]
    rows = np.flatnonzero(wanted)
    rows = rows[np.lexsort((number[rows], sequence[rows]))]
    _, starts, counts = np.unique(sequence[rows], return_index=True, return_counts=True)
    return rows[starts[counts == ATTEMPTS][:, None] + np.arange(ATTEMPTS)]


def _beliefs(chains: Chains, setting: FilterConfig, config: Config) -> tuple[Array, Array]:
    """Return means (n, 5, 2) and covariances (n, 5, 2, 2) after each attempt."""
    std = config.detector.prior_std_m

    def one(seen: Observation, start: Array) -> tuple[Array, Array]:
        def step(belief, given):
            reading, at = given
            reading = replace(reading, innovation=reading.innovation + at - belief.pos_mean_world)
            belief = update_position(belief, reading, setting, std)
            return belief, (belief.pos_mean_world, belief.pos_cov)

        return jax.lax.scan(step, initial_belief(start[0], std, config.scene.n_types), (seen, start))[1]

    return jax.tree.map(np.asarray, jax.jit(jax.vmap(one))(chains.seen, jnp.asarray(chains.start_m)))


def _scores(chains: Chains, setting: FilterConfig, config: Config, own: slice = slice(None)) -> Scores:
    mean, cov = (np.asarray(leaf)[own] for leaf in _beliefs(chains, setting, config))
    miss = chains.hole_m[own, None] - mean
    distance, squared = np.linalg.norm(miss, axis=-1), _squared(miss, cov)
    nll = np.asarray(gaussian_nll(jnp.asarray(chains.hole_m[own, None]), mean, cov))
    by_attempt = (1000 * distance, inside(squared, 0.9), squared / 2, nll)
    means = ([round(float(value), 3) for value in values.mean(0)] for values in by_attempt)
    return Scores(*means, runaways=int(run_away(CM_PER_M * distance, squared).sum()))


def _squared(miss: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Compute squared Mahalanobis distances (n, 5) of (n, 5, 2) under (n, 5, 2, 2)."""
    return squared_mahalanobis(miss.reshape(-1, 2), cov.reshape(-1, 2, 2)).reshape(miss.shape[:2])


def _by_distance(chains: Chains) -> dict[str, dict[str, float]]:
    """Compute the NEES of single readings by the distance from the start of the attempt to the hole."""
    offset = chains.hole_m[:, None] - chains.start_m
    nees = _squared(offset - chains.seen.innovation, np.asarray(chains.seen.pos_noise_cov)) / 2
    distance = 1000 * np.linalg.norm(offset, axis=-1)
    rows = {}
    for low, high in itertools.pairwise(DISTANCES_MM):
        here = nees[(distance >= low) & (distance < high)]
        if here.size:
            rows[f"{low} to {high} mm"] = {"n": int(here.size), "nees": round(float(here.mean()), 2)}
    return rows


class Loss(NamedTuple):
    """Distance of the coverage from the range ``COVERED``, then the negative log-likelihood."""

    beyond: float
    nll: float


Losses = dict[str, dict[float, Loss]]
"""Losses by key and value."""


def _losses(chains: Chains, config: Config, own: slice) -> Losses:
    """Compute what ρ and the temperature are fitted by: see the top of this file."""

    def loss_of(correlation: float) -> Loss:
        scores = _scores(chains, replace(NONE, correlation=correlation), config, own)
        held, (low, high) = np.round(scores.coverage_90, 2), COVERED
        beyond = max(low - held.min(), held.max() - high, 0.0)
        return Loss(round(float(beyond), 2), round(float(np.mean(scores.nll)), 4))

    return {
        "correlation": {value: loss_of(value) for value in CORRELATIONS},
        "match_temperature": {value: Loss(0.0, _match_nll(chains, value, own)) for value in TEMPERATURES},
    }


def _fitted(losses: dict[str, Losses]) -> dict[str, float]:
    """Return the value of each key with the smallest loss, summed over the worlds."""
    keys = next(iter(losses.values()))
    return {
        key: min(keys[key], key=lambda value: tuple(np.sum([own[key][value] for own in losses.values()], 0)))
        for key in keys
    }


def _match_nll(chains: Chains, temperature: float, own: slice) -> float:
    logits, matches = chains.logits[own], chains.matches[own]
    logp = np.asarray(jax.nn.log_softmax(jnp.asarray(logits / temperature), axis=-1))
    return round(float(-logp[np.arange(len(logp)), matches.astype(int)].mean()), 4)


if __name__ == "__main__":
    process_setup.configure()
    main(*map(Path, sys.argv[1:4]))
