"""Train the sensor, then the frame-by-frame baseline of the paper, in one run."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mjx_fit.config.schema import Config
from mjx_fit.data.episode import Episode
from mjx_fit.data.joined import load_joined
from mjx_fit.data.manifest import read_manifest
from mjx_fit.training.checkpoint import FRAME_BY_FRAME
from mjx_fit.training.compatibility import require_world
from mjx_fit.training.loop import train
from mjx_fit.training.run import Run, held
from mjx_fit.training.split import require_chains, require_growing, require_symmetric
from mjx_fit.utils import memory
from mjx_fit.utils.rates import ACTION_BYTES


def train_from(folders: Sequence[Path], config: Config, run: Run) -> bool:
    """Train both sensors on stored data sets, or resume their training.

    Args:
        folders: Folders of the data sets.
        config: Full configuration.
        run: Output folder, seed, number of sensors and initial weights.

    Returns:
        False if the run was already complete.

    Raises:
        RequestError: The data come from another scene or controller, ``train.sequence`` does not suit the
            data, or ``train.mirror`` does not suit the shapes; see also ``mjx_fit.training.loop.train``.
    """
    manifests = [read_manifest(folder) for folder in folders]
    for there in manifests:
        require_world(there.request, config)
        require_chains(there.request, config)
    require_symmetric(config)
    require_growing(config)
    episodes = sum(shard.episodes for there in manifests for shard in there.shards)
    _require_memory(episodes, max(there.request["steps"] for there in manifests), config)
    return train_with_baseline(load_joined(folders), config, run)


@held
def train_with_baseline(data: Episode, config: Config, run: Run) -> bool:
    """Train the sensor, then the frame-by-frame baseline on the same episodes, or resume either.

    ``checkpoint.load_sensor(run.out / FRAME_BY_FRAME)`` loads the baseline; each member has its own. The
    baseline is skipped if ``train.baseline_share`` is 0 or the sensor itself is frame-by-frame.

    Returns:
        False if the run was already complete.

    Raises:
        RequestError: See ``mjx_fit.training.loop.train``.
    """
    _say_what_is_left_out(data)
    trained = train(data, config, run)
    if config.train.baseline_share and config.sensor.reference != "final":
        trained |= train(data, _of_baseline(config), replace(run, inside=FRAME_BY_FRAME))
    return trained


def _require_memory(episodes: int, steps: int, config: Config) -> None:
    """Refuse training that cannot fit in memory: all traces and one batch of windows."""
    memory.require(episodes * steps * ACTION_BYTES, f"--data: {episodes:,} interactions", "train on fewer")
    windows = min(config.train.batch_size, episodes) * config.train.max_window
    memory.require(
        (episodes * steps + windows) * ACTION_BYTES,
        f"config: train.batch_size: {config.train.batch_size} with these data",
        "lower it, or lower train.max_window",
    )


def _say_what_is_left_out(data: Episode) -> None:
    invalid = np.asarray(~data.rollout.truth.valid)
    if invalid.any():
        print(
            f"mjx-fit: {invalid.sum():,} of {len(invalid):,} interactions are invalid and left out",
            file=sys.stderr,
        )


def _of_baseline(config: Config) -> Config:
    epochs = max(1, round(config.train.baseline_share * config.train.epochs))
    return replace(
        config,
        sensor=replace(config.sensor, reference="final"),
        train=replace(config.train, epochs=epochs),
    )
