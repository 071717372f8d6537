"""The sensor and, behind it, the baseline that the paper compares it with, in one run."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from mjx_fit.config import Config
from mjx_fit.dataset import manifest, store
from mjx_fit.dataset.episode import Episode
from mjx_fit.training import run_folder
from mjx_fit.training.kinship import require_world
from mjx_fit.training.loop import train
from mjx_fit.training.sides import require_chains, require_symmetric

FRAME_BY_FRAME = "frame_by_frame"
"""Folder of the baseline's training, in that of the run."""


def train_from(folder: Path, config: Config, out: Path, seed: int, members: int = 1) -> None:
    """Train both on a stored data set, or go on with what was begun.

    Args:
        folder: Of the data set.
        config: Everything.
        out: Folder of the run.
        seed: Root seed.
        members: Of an ensemble.

    Raises:
        RequestError: The data are of another scene or controller, ``train.sequence`` does not fit them, or
            ``train.mirror`` the shapes; and
            as ``mjx_fit.training.loop.train``.
    """
    request = manifest.read(folder).request
    require_world(request, config)
    require_chains(request, config)
    require_symmetric(config)
    train_with_baseline(store.load(folder), config, out, seed, members)


@run_folder.held
def train_with_baseline(data: Episode, config: Config, out: Path, seed: int, members: int = 1) -> None:
    """Train the sensor, then the frame-by-frame one on the same episodes, or go on with what was begun.

    ``checkpoint.load_sensor(out / FRAME_BY_FRAME)`` loads the second; each member of an ensemble has its own.
    With ``train.baseline_share: 0``, or where the sensor itself is of that kind, it is left out.

    Raises:
        RequestError: As ``mjx_fit.training.loop.train``.
    """
    _say_what_is_left_out(data)
    train(data, config, out, seed, members=members)
    if config.train.baseline_share and config.sensor.reference != "final":
        train(data, _of_baseline(config), out, seed, members=members, inside=FRAME_BY_FRAME)


def _say_what_is_left_out(data: Episode) -> None:
    invalid = np.asarray(~data.interaction.valid)
    if invalid.any():
        print(
            f"mjx-fit: {invalid.sum():,} of {len(invalid):,} interactions are not valid: left out",
            file=sys.stderr,
        )


def _of_baseline(config: Config) -> Config:
    epochs = max(1, round(config.train.baseline_share * config.train.epochs))
    return replace(
        config,
        sensor=replace(config.sensor, reference="final"),
        train=replace(config.train, epochs=epochs),
    )
