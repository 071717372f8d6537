"""Train/validation split of the episodes, and checks that they are usable for training."""

from dataclasses import replace
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Int

from mjx_fit.config.schema import Config
from mjx_fit.data.episode import Episode
from mjx_fit.data.split import split_sequences
from mjx_fit.data.windows import usable
from mjx_fit.scene.outline import is_its_own_mirror_image
from mjx_fit.sensors.encoder import WRENCH_AXES
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.rates import SUBSTEPS


def usable_sides(
    data: Episode, config: Config, seed: int
) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "m"]]:
    """Return the indices of the training and the validation episodes.

    The split precedes the removal of unusable episodes, so a removal never changes the side of the others.

    Raises:
        RequestError: No episode is left for training or for validation, or the data are invalid.
    """
    if config.train.min_window > config.train.max_window:
        raise RequestError(
            f"config: train.min_window: {config.train.min_window} is invalid: "
            f"expected at most train.max_window, {config.train.max_window}"
        )
    keep = usable(data)
    sides = split_sequences(np.asarray(data.sequence), config.train.validation_fraction, seed)
    train_ids, val_ids = (ids[keep[ids]] for ids in sides)
    if not len(train_ids) or not len(val_ids):
        raise RequestError(
            f"--data: {len(train_ids)} training and {len(val_ids)} validation interactions cannot be used: "
            "at least one of each must be valid and long enough"
        )
    require_sound(data, keep, config.scene.n_types)
    return train_ids, val_ids


def require_chains(request: dict[str, Any], config: Config) -> None:
    """Check that beliefs can be passed along the attempts of a data set.

    The estimates must come from a sensor. A sampled estimate is drawn around the truth and reveals it beyond
    what the passed belief accounts for: a sensor trained on such data is overconfident in deployment.

    Args:
        request: Request that the data set was collected with.
        config: Configuration, with ``train.sequence`` in use.

    Raises:
        RequestError: The sequences are too short, their later estimates were sampled, or windows may be
            shorter than the attempts (the start of the second attempt would then reveal all information
            from the first one).
    """
    wanted, there = config.train.sequence, request["sequence"]
    if wanted == 1:
        return
    if there < wanted:
        raise RequestError(
            f"config: train.sequence: {wanted} cannot be used with these --data: their "
            f"sequences have {there} attempts; collect them with --sequence {wanted}"
        )
    if not request.get("sensor"):
        raise RequestError(
            f"config: train.sequence: {wanted} cannot be used with these --data: their later attempts start "
            "from sampled estimates; collect them with the --run of a sensor"
        )
    whole = min(request["steps"], request["config"]["task"]["attempt_actions"])
    if config.train.min_window < whole:
        raise RequestError(
            f"config: train.min_window: {config.train.min_window} cannot be used with train.sequence "
            f"{wanted}: expected at least {whole}, a whole attempt of these --data"
        )


def require_growing(config: Config) -> None:
    """Check that a sensor can be trained after every action.

    Raises:
        RequestError: ``train.every_action`` is set, and the sensor looks ahead or beliefs are passed on.
    """
    if config.train.every_action and not config.sensor.causal:
        raise RequestError(
            "config: train.every_action: True cannot be used with sensor.causal false: the sensor looks ahead"
        )
    if config.train.every_action and config.train.sequence > 1:
        raise RequestError(
            f"config: train.every_action: True cannot be used with train.sequence {config.train.sequence}: "
            "expected 1"
        )


def require_symmetric(config: Config) -> None:
    """Check that mirrored windows are physically possible.

    Raises:
        RequestError: ``train.mirror`` is set, and a shape is not its own mirror image.
    """
    lopsided = [
        shape.name for shape in config.scene.shapes if not is_its_own_mirror_image(shape, config.scene)
    ]
    if config.train.mirror and lopsided:
        raise RequestError(
            f"config: train.mirror: True cannot be used: the shape {lopsided[0]!r} is not mirror-symmetric "
            "in y; add --set train.mirror=false"
        )


def require_sound(data: Episode, keep: Bool[np.ndarray, "episodes"], n_types: int) -> None:
    """Check that these episodes are valid inputs of a sensor.

    Args:
        data: Stacked episodes.
        keep: Whether each episode is in use.
        n_types: Number of shapes that the sensor distinguishes.

    Raises:
        RequestError: An episode has windows of another size, an unknown type or a non-finite number.
    """
    rollout = data.rollout
    window = rollout.felt.trace.wrench_sensor.shape[2:]
    if window != (SUBSTEPS, WRENCH_AXES):
        raise RequestError(
            f"--data: wrench_sensor: windows of shape {window} cannot be used: "
            f"expected {(SUBSTEPS, WRENCH_AXES)}"
        )
    for name, every in (("peg_type", rollout.felt.peg_type), ("hole_type", rollout.truth.hole_type)):
        types = np.asarray(every)[keep]
        wrong = types[(types < 0) | (types >= n_types)]
        if len(wrong):
            raise RequestError(f"--data: {name}: {wrong[0]} is invalid: there are {n_types} types, from 0")
    # No sensor reads where the arm ended, and nobody knows it of a robot.
    truth = replace(rollout.truth, end_qpos=np.zeros(len(keep)), end_qvel=np.zeros(len(keep)))
    data = replace(data, rollout=replace(rollout, truth=truth))
    for path, leaf in jax.tree_util.tree_leaves_with_path(data):
        values = np.asarray(leaf).reshape(len(keep), -1)
        broken = np.asarray(~np.isfinite(values).all(axis=1)) & keep
        if broken.any():
            episode = np.asarray(data.episode)[broken][0]
            name = jax.tree_util.keystr(path[-1:], simple=True)
            raise RequestError(f"--data: {name} of episode {episode} is invalid: expected finite numbers")
