"""Share code among the scripts of this folder: readings of failed spirals and their ground truth."""

from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from mjx_fit.config.files import read_config
from mjx_fit.config.worlds import world_file
from mjx_fit.data import reader
from mjx_fit.data.episode import Episode
from mjx_fit.evaluation.held_out import failed_attempts
from mjx_fit.evaluation.statistics import bootstrap_mean
from mjx_fit.sensors.reading import Window, read_window
from mjx_fit.types import Reading
from mjx_fit.utils.randomness import root_key

WORLD = "as-2026-11"
"""The world that this page describes."""
CONFIG = read_config(world_file(WORLD))
ACTIONS = CONFIG.task.attempt_actions


@dataclass(frozen=True)
class Attempts:
    """Failed attempts as sensor inputs, with the expected outputs.

    Attributes:
        reading: n readings, NumPy.
        offset_cm: Offset of the hole from the estimate, cm.
        peg, hole: Types of peg and hole.
    """

    reading: Reading
    offset_cm: Float[np.ndarray, "n 2"]
    peg: Int[np.ndarray, "n"]
    hole: Int[np.ndarray, "n"]


def first_attempts(folder: Path) -> Episode:
    """Load the failed first attempts of each sequence, which start from the detector's estimate."""
    data = reader.load(folder)
    ids = failed_attempts(data, ACTIONS)
    ids = ids[np.asarray(data.number)[ids] == 0]
    return jax.tree.map(lambda leaf: np.asarray(leaf)[ids], data)


def shown(data: Episode, seed: int = 0, batch: int = 256) -> Attempts:
    """Read episodes, with noise drawn by the episode's id."""
    root = root_key(seed, "baselines")

    @jax.jit
    def some(episodes: Episode) -> Reading:
        def one(episode: Episode):
            key = jax.random.fold_in(root, episode.episode)
            return read_window(episode.rollout.felt, key, CONFIG, Window(ACTIONS))

        return jax.vmap(one)(episodes)

    n, parts = len(data.episode), []
    for start in range(0, n, batch):
        rows = np.resize(np.arange(start, min(start + batch, n)), batch)
        parts.append(
            jax.tree.map(np.asarray, some(jax.tree.map(lambda leaf, r=rows: jnp.asarray(leaf[r]), data)))
        )
    rollout = data.rollout
    return Attempts(
        jax.tree.map(lambda *leaves: np.concatenate(leaves)[:n], *parts),
        100 * np.asarray(rollout.truth.hole_pos_world - rollout.felt.estimate_world, float),
        np.asarray(rollout.felt.peg_type),
        np.asarray(rollout.truth.hole_type),
    )


def mean_of(values: Float[np.ndarray, " n"]) -> dict[str, float]:
    """Compute the mean over attempts at n holes, with its 95 % interval."""
    value, low, high = bootstrap_mean(values, np.arange(len(values)).tolist())
    return {"value": value, "low": low, "high": high}
