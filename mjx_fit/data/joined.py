"""Several data sets as one, for training."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Float

from mjx_fit.config.schema import Config, config_from_stored
from mjx_fit.data.episode import Episode, padded
from mjx_fit.data.manifest import read_complete_manifest, require_truth
from mjx_fit.data.manifest_schema import MAX_EPISODES
from mjx_fit.data.reader import load
from mjx_fit.scene.placement import GRASP, SOCKET, TOOL
from mjx_fit.types.physics import Physics
from mjx_fit.utils.errors import RequestError

POSES = (*SOCKET, *TOOL, *GRASP)
"""Quantities on which the place that an attempt can tell depends (``scene.placement.place_for_tool``)."""


def load_joined(folders: Sequence[Path]) -> Episode:
    """Load several data sets as one for training, with the poses of their worlds as their only physics.

    Where an attempt of a robot began is left out: no sensor reads it, and simulated attempts do not have it.
    The ids of data set k are larger by k ``MAX_EPISODES``, so that no two sequences share one.

    Args:
        folders: Folders of the data sets.

    Raises:
        RequestError: As in ``load``, or a folder is given twice.
    """
    if len({folder.resolve() for folder in folders}) < len(folders):
        raise RequestError("--data: a folder is given twice: give each data set once")
    sets = [load(folder) for folder in folders]
    poses = [_poses(one, _config_of(folder)) for one, folder in zip(sets, folders, strict=True)]
    varying = [name for name in POSES if any(one[name].any() for one in poses)]
    sets = [
        _with_poses(one, {name: own[name] for name in varying}) for one, own in zip(sets, poses, strict=True)
    ]
    if len(sets) == 1:
        return sets[0]
    actions = max(one.rollout.felt.trace.action_world.shape[1] for one in sets)
    shifted = (_shifted(k, one, actions) for k, one in enumerate(sets))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *shifted)


def _config_of(folder: Path) -> Config:
    request = read_complete_manifest(folder).request
    require_truth(folder, request)
    return config_from_stored(request["config"])


def _poses(data: Episode, config: Config) -> dict[str, Float[np.ndarray, "n"]]:
    """Return the poses of all worlds: those that they drew, or those of the data set's configuration."""
    constant = vars(config.arm) | vars(config.placement)
    drawn = vars(data.rollout.truth.physics)
    return {
        name: np.full(len(data.episode), constant[name], np.float32) if drawn[name] is None else drawn[name]
        for name in POSES
    }


def _with_poses(data: Episode, poses: dict[str, Float[np.ndarray, "n"]]) -> Episode:
    truth = replace(data.rollout.truth, physics=Physics(**poses))
    felt = replace(data.rollout.felt, start=None)
    return replace(data, rollout=replace(data.rollout, felt=felt, truth=truth))


def _shifted(k: int, data: Episode, actions: int) -> Episode:
    """Return data set k of several, with unique ids and traces of this length."""
    ids = {name: getattr(data, name) + k * MAX_EPISODES for name in ("episode", "sequence")}
    return replace(data, **ids, rollout=padded(data.rollout, actions))
