"""Which episodes train and which validate, and whether they can be trained on at all."""

from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Int

from mjx_fit.config.schema import Config
from mjx_fit.data.episode import Episode
from mjx_fit.data.windows import split, usable
from mjx_fit.sensors.encoder import WRENCH_AXES
from mjx_fit.types import SUBSTEPS
from mjx_fit.utils.errors import RequestError


def usable_sides(
    data: Episode, config: Config, seed: int
) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "m"]]:
    """Indices of the training and of the validation episodes.

    Divided first, so that an episode that is dropped does not move the others to another side.

    Raises:
        RequestError: There is nothing to train or to validate on, or the data are not of this kind.
    """
    if config.train.min_window > config.train.max_window:
        raise RequestError(
            f"config: train.min_window: {config.train.min_window} is invalid: "
            f"expected at most train.max_window, {config.train.max_window}"
        )
    keep = usable(data)
    sides = split(np.asarray(data.sequence), config.train.validation_fraction, seed)
    train_ids, val_ids = (ids[keep[ids]] for ids in sides)
    if not len(train_ids) or not len(val_ids):
        raise RequestError(
            f"--data: {len(train_ids)} training and {len(val_ids)} validation interactions cannot be used: "
            "at least one of each must be valid and long enough"
        )
    require_sound(data, keep, config.scene.n_types)
    return train_ids, val_ids


def require_chains(request: dict[str, Any], config: Config) -> None:
    """Make sure that beliefs can be handed on along the attempts of a data set.

    A drawn estimate is drawn around the truth: a belief that is handed on does not know that, and a sensor
    that learns it is too sure of itself when it is on its own.

    Args:
        request: What the data set was asked to be.
        config: ``train.sequence`` is used.

    Raises:
        RequestError: Its sequences are too short, their later estimates were drawn, or windows may be shorter
            than the attempts: where the second attempt begins tells all that the first one had told.
    """
    wanted, there = config.train.sequence, request["sequence"]
    if wanted == 1:
        return
    if there < wanted:
        raise RequestError(
            f"config: train.sequence: {wanted} cannot be used with these --data: they have "
            f"{there} attempts in a row; collect them with --sequence {wanted}"
        )
    if not request.get("sensor"):
        raise RequestError(
            f"config: train.sequence: {wanted} cannot be used with these --data: their later attempts start "
            "from drawn estimates; collect them with the --run of a sensor"
        )
    whole = min(request["steps"], request["config"]["task"]["attempt_actions"])
    if config.train.min_window < whole:
        raise RequestError(
            f"config: train.min_window: {config.train.min_window} cannot be used with train.sequence "
            f"{wanted}: it must be at least {whole}, a whole attempt of these --data"
        )


def require_symmetric(config: Config) -> None:
    """Make sure that what mirrored windows show could be.

    Raises:
        RequestError: ``train.mirror`` is asked for, and a shape is not its own mirror image.
    """
    lopsided = [shape.name for shape in config.scene.shapes if not shape.is_its_own_mirror_image]
    if config.train.mirror and lopsided:
        raise RequestError(
            f"config: train.mirror: True cannot be used: mirrored, the shape {lopsided[0]!r} is another one"
        )


def require_sound(data: Episode, keep: Bool[np.ndarray, "episodes"], n_types: int) -> None:
    """Make sure that a sensor can be shown these episodes.

    Args:
        data: Stacked episodes.
        keep: Which of them it is to be shown.
        n_types: Number of shapes that it knows.

    Raises:
        RequestError: One has a window of another size, a type that does not exist, or a number that is not
            finite.
    """
    rollout = data.rollout
    window = rollout.felt.trace.wrench_sensor.shape[2:]
    if window != (SUBSTEPS, WRENCH_AXES):
        raise RequestError(
            f"--data: wrench_sensor: windows of shape {window} cannot be used: "
            f"a sensor reads {(SUBSTEPS, WRENCH_AXES)}"
        )
    for name, every in (("peg_type", rollout.felt.peg_type), ("hole_type", rollout.truth.hole_type)):
        types = np.asarray(every)[keep]
        wrong = types[(types < 0) | (types >= n_types)]
        if len(wrong):
            raise RequestError(f"--data: {name}: {wrong[0]} is invalid: there are {n_types} types, from 0")
    for path, leaf in jax.tree_util.tree_leaves_with_path(data):
        values = np.asarray(leaf).reshape(len(keep), -1)
        broken = np.asarray(~np.isfinite(values).all(axis=1)) & keep
        if broken.any():
            episode = np.asarray(data.episode)[broken][0]
            name = jax.tree_util.keystr(path[-1:], simple=True)
            raise RequestError(f"--data: {name} of episode {episode} is invalid: it must hold finite numbers")
