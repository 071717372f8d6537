"""Compare ways for the histogram filter to use h_match, on a frozen sensor.

    python experiments/learning/match_model.py COUNTED SEQUENCES RUN

COUNTED is a data set that was not used to train the run, SEQUENCES another, collected with ``--run RUN``.

``soft``: the mean of the trained H over the output of h_match, as in training. ``hard``: the trained H at the
arg max of h_match, as in Algorithm 3. ``hard, counted``: the same with H from the frequencies in COUNTED.
``h_match itself``: no H; h_match updates the odds of a match directly, and all mismatches equally. Each way
is scored by the posterior of the type after 1, 2 and 3 failed attempts, from the prior of a data set: half of
the holes match. Scores are the negative log-likelihood of the true type and the Brier score of a match.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import shared
from jaxtyping import Float, Int
from scipy.special import log_softmax

from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.data import reader
from mjx_fit.data.episode import Episode
from mjx_fit.evaluation import held_out
from mjx_fit.report import script
from mjx_fit.training.checkpoint import load_sensor
from mjx_fit.types import Observation
from mjx_fit.utils import process_setup

TYPES = SceneConfig().n_types


def main(counted_on: Path, sequences: Path, run: Path) -> None:
    sensor, config = load_sensor(run)

    def observed(folder: Path) -> tuple[Episode, Int[np.ndarray, "n"], Observation]:
        data = reader.load(folder)
        ids = held_out.failed_attempts(data, shared.ACTIONS)
        return data, ids, held_out.observe(sensor, data, ids, shared.ACTIONS, config, seed=0)

    counted = _counted(*observed(counted_on))
    data, ids, seen = observed(sequences)
    counted_seen = replace(seen, match_model_logp=counted[data.rollout.felt.peg_type[ids]])
    itself = replace(seen, match_model_logp=_identity()[data.rollout.felt.peg_type[ids]])
    results = {}
    for name, observation, hard in (
        ("soft", seen, False),
        ("hard", seen, True),
        ("hard, counted", counted_seen, True),
        ("h_match itself", itself, False),
    ):
        chosen = replace(config, task=replace(config.task, hard_match=hard))
        belief = held_out.posterior(observation, data, ids, chosen, with_prior=True).belief
        results[name] = _scores(np.asarray(belief.type_logp), data, ids)
    script.save(Path(__file__).parent / "match_model.json", {"run": run.name, "ways": results})


def _counted(data: Episode, ids: Int[np.ndarray, "n"], seen: Observation) -> Float[np.ndarray, "C C 2"]:
    """Compute ln H(o | hole, peg) from the frequencies of h_match's arg max, with add-one smoothing."""
    peg, hole = (np.asarray(leaf)[ids] for leaf in (data.rollout.felt.peg_type, data.rollout.truth.hole_type))
    counts = np.ones((TYPES, TYPES, 2))
    np.add.at(counts, (peg, hole, np.asarray(seen.match_logits).argmax(-1)), 1)
    return np.log(counts / counts.sum(-1, keepdims=True)).astype(np.float32)


def _identity() -> Float[np.ndarray, "C C 2"]:
    """Return ln H of a sensor that is never wrong, so that its output is used directly."""
    match = np.eye(TYPES, dtype=bool)[..., None] == np.array([False, True])
    return np.where(match, 0.0, -30.0).astype(np.float32)


def _scores(type_logp: Float[np.ndarray, "n C"], data: Episode, ids: Int[np.ndarray, "n"]) -> dict:
    rollout, number = data.rollout, np.asarray(data.number)[ids]
    peg, hole = (np.asarray(leaf)[ids] for leaf in (rollout.felt.peg_type, rollout.truth.hole_type))
    rows = np.arange(len(ids))
    # The filter's prior is a third for each type; updates are products, so another prior is one more factor.
    start = np.where(np.arange(TYPES) == peg[:, None], 0.5, 0.25)
    type_logp = log_softmax(type_logp + np.log(start), axis=1)
    nll = -type_logp[rows, hole]
    brier = np.square(np.exp(type_logp[rows, peg]) - (peg == hole))
    return {
        f"after {k + 1}": {
            "n": int((number == k).sum()),
            "type_nll": shared.mean_of(nll[number == k]),
            "match_brier": shared.mean_of(brier[number == k]),
        }
        for k in range(3)
    }


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(f"usage: python {sys.argv[0]} COUNTED SEQUENCES RUN")
    process_setup.configure()
    main(*map(Path, sys.argv[1:]))
