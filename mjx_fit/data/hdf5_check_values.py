"""Check the values of a shard after reading and before use."""

from dataclasses import replace

import jax
import numpy as np

from mjx_fit.data.episode import Episode, happened

LARGEST = 1e12
"""Largest magnitude of a simulated value, whose square is still far below the largest float."""


def require(
    episodes: Episode,
    first_episode: int,
    sequence: int,
    *,
    types: int,
    policies: int,
    unknown: tuple[str, ...] = (),
) -> None:
    """Check that the values of a shard are valid.

    Args:
        episodes: Stacked episodes, as NumPy arrays of the right types and shapes.
        first_episode: Id of the first episode; ids are consecutive.
        sequence: Number of consecutive attempts at one hole.
        types: Number of shapes.
        policies: Number of policies that the index may refer to.
        unknown: Fields of the truth that the shard does not have, since a robot made it.

    Raises:
        ValueError: A value is invalid; the message names the field and the episode.
    """
    if unknown:
        truth = episodes.rollout.truth
        nothing = {name: np.zeros_like(getattr(truth, name)) for name in unknown}
        truth = replace(truth, **nothing | {"valid": np.ones_like(truth.valid)})
        episodes = replace(episodes, rollout=replace(episodes.rollout, truth=truth))
    data = episodes.rollout
    ids = first_episode + np.arange(len(episodes.episode))
    for name, values, right in (
        ("episode", episodes.episode, ids),
        ("sequence", episodes.sequence, ids // sequence),
        ("number", episodes.number, ids % sequence),
    ):
        _require(name, values, values == right, ids, "expected the ids of the manifest")
    for name, values, end in (
        ("policy", episodes.policy, policies),
        ("peg_type", data.felt.peg_type, types),
        ("hole_type", data.truth.hole_type, types),
        ("length", data.felt.length, data.felt.trace.action_world.shape[1] + 1),
    ):
        _require(name, values, (values >= 0) & (values < end), ids, f"expected 0 to {end - 1}")
    for name, flags in (("inserted", data.truth.inserted), ("valid", data.truth.valid)):
        _require(name, flags, np.asarray(flags).view(np.uint8) < 2, ids, "expected true or false")
    place = np.asarray(data.truth.hole_pos_world)
    _require("hole_pos_world", place, np.isfinite(place), ids, "expected a finite number")
    _require_numbers(episodes, ids)


def require_flags(contact: np.ndarray, first_episode: int) -> None:
    """Check that the contact flags of a shard are booleans.

    Raises:
        ValueError: A byte is neither 0 nor 1; the message names the episode.
    """
    ids = first_episode + np.arange(len(contact))
    _require("contact", contact, contact.view(np.uint8) < 2, ids, "expected true or false")


def _require_numbers(episodes: Episode, ids: np.ndarray) -> None:
    """Check that valid episodes contain finite numbers; diverged ones may contain others."""
    performed = np.asarray(happened(episodes))
    for path, leaf in jax.tree_util.tree_leaves_with_path(episodes):
        values = np.asarray(leaf)
        if values.dtype.kind != "f":
            continue
        # The comparison is also false for NaN.
        right = (np.abs(values) <= LARGEST).reshape(len(ids), -1).all(axis=1) | ~performed
        name = jax.tree_util.keystr(path[-1:], simple=True)
        _require(name, values, right, ids, f"expected a finite number, at most {LARGEST:.0e}")


def _require(name: str, values, right, ids: np.ndarray, allowed: str) -> None:
    right = np.asarray(right).reshape(len(ids), -1).all(axis=1)
    if not right.all():
        row = int(np.argmin(right))
        shown = f" {values[row]}" if np.ndim(values) == 1 else ""
        raise ValueError(f"{name} of episode {ids[row]}:{shown} is invalid: {allowed}".replace(": is", " is"))
