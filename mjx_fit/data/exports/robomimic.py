"""HDF5 in the layout of robomimic demonstrations."""

import io
import json
from pathlib import Path

import h5py
import jax
import numpy as np
from jaxtyping import Int

from mjx_fit.config.schema import Config, config_from_stored
from mjx_fit.data.episode import UNKNOWN, Episode, happened
from mjx_fit.data.manifest import Manifest
from mjx_fit.data.reader import read_shards
from mjx_fit.data.schedule import stored_policies
from mjx_fit.data.split import split_sequences
from mjx_fit.sensors.force_torque import in_contact
from mjx_fit.sensors.pose import start_of
from mjx_fit.types import Rollout
from mjx_fit.utils.progress import Progress
from mjx_fit.utils.rates import SUBSTEPS

_STATE = (
    "tip_pos_world",
    "tip_quat_world",
    "tip_linvel_world",
    "tip_angvel_world",
    "wrench_sensor",
    "contact",
)
"""Observations of the robot at the end of an action."""

_GYM_TYPE = 2
"""``robomimic.envs.env_base.EnvType.GYM_TYPE``, robomimic's type for generic environments.

It only labels the data; robomimic cannot simulate this environment."""

_SEED = 0
"""Seed of the train/validation split: the default of ``mjx-fit train``."""


def write_robomimic(folder: Path, manifest: Manifest, path: Path) -> None:
    """Write one group ``data/demo_<episode>`` per episode and the masks ``mask/train`` and ``mask/valid``.

    Row t of ``obs`` precedes action t and row t of ``next_obs`` follows it; each contains the wrenches
    (50, 6) of the preceding action. Actions have six components if they turn the TCP. Before the first action
    the robot is at rest above the estimate, pointing along its axis. The masks are the default
    train/validation split of ``mjx-fit train``: all demonstrations of a sequence share one mask. The file is
    built in memory, because the HDF5 library does not survive a full disk.
    """
    config = config_from_stored(manifest.request["config"])
    total, buffer = 0, io.BytesIO()
    names: list[str] = []
    sequences: list[int] = []
    with h5py.File(buffer, "w") as file, Progress("export: shard", len(manifest.shards)) as progress:
        root = file.create_group("data", track_order=True)
        about = {"env_name": "mjx_fit", "type": _GYM_TYPE, "env_kwargs": manifest.request}
        root.attrs["env_args"] = json.dumps(about)
        for done, shard in enumerate(read_shards(folder, manifest.shards, manifest.request), 1):
            kept = happened(shard)
            sequences += np.asarray(shard.sequence).tolist()
            names += [
                f"demo_{episode}" if is_kept else ""
                for episode, is_kept in zip(shard.episode.tolist(), kept, strict=True)
            ]
            for row in np.flatnonzero(kept):
                episode = jax.tree.map(lambda leaf, row=row: leaf[row], shard)
                policy = stored_policies(manifest.request["policy"])[int(episode.policy)]
                total += _add_demonstration(root, episode, policy, config)
            progress(done)
        root.attrs["total"] = total
        for side, ids in _sides(np.array(sequences), config.train.validation_fraction).items():
            file[f"mask/{side}"] = np.array([names[i] for i in ids if names[i]], dtype="S")
    path.write_bytes(buffer.getbuffer())


def _sides(sequences: Int[np.ndarray, "n"], fraction: float) -> dict[str, Int[np.ndarray, "m"]]:
    """Split episodes into training and validation; a single sequence cannot be split and goes to training."""
    if len(np.unique(sequences)) < 2:
        return {"train": np.arange(len(sequences)), "valid": np.zeros(0, int)}
    return dict(zip(("train", "valid"), split_sequences(sequences, fraction, _SEED), strict=True))


def _add_demonstration(root: h5py.Group, episode: Episode, policy: str, config: Config) -> int:
    names = config.scene.names
    rollout = episode.rollout
    n = int(rollout.felt.length)
    demo = root.create_group(f"demo_{int(episode.episode)}")
    demo.attrs["num_samples"] = n
    demo.attrs["peg_type"] = names[int(rollout.felt.peg_type)]
    demo.attrs["policy"] = policy
    if rollout.truth.hole_type != UNKNOWN:
        demo.attrs["hole_type"] = names[int(rollout.truth.hole_type)]
        demo.attrs["inserted"] = bool(rollout.truth.inserted)
        demo.attrs["hole_pos_world"] = rollout.truth.hole_pos_world
    demo.attrs["estimate_world"] = rollout.felt.estimate_world
    demo.attrs["tare_sensor"] = rollout.felt.tare_sensor
    demo.attrs["sequence"], demo.attrs["number"] = int(episode.sequence), int(episode.number)
    demo.attrs["estimate_cov"] = episode.estimate_cov
    ended = np.arange(n) == n - 1
    trace = rollout.felt.trace
    commands = [trace.action_world] if trace.turn_world is None else [trace.action_world, trace.turn_world]
    demo["actions"] = np.concatenate(commands, -1)[:n]
    demo["rewards"] = (ended & rollout.succeeded).astype(np.float32)
    demo["dones"] = ended.astype(np.int64)
    first = _at_rest(rollout, config)
    clean = rollout.felt.trace.wrench_sensor - rollout.felt.tare_sensor
    state = vars(rollout.felt.trace) | {"contact": in_contact(clean, config.wrist)}
    for name in _STATE:
        after = np.asarray(state[name][:n])
        if after.ndim == 1:  # robomimic only normalises float vectors
            after = after.astype(np.float32)[:, None]
        before = np.concatenate(
            [np.reshape(first[name], (1, *after.shape[1:])).astype(after.dtype), after[:-1]]
        )
        for group, rows in (("obs", before), ("next_obs", after)):
            demo.create_dataset(f"{group}/{name}", data=rows, compression="gzip", compression_opts=1)
    return n


def _at_rest(rollout: Rollout, config: Config) -> dict[str, np.ndarray]:
    start = start_of(rollout.felt, config)
    return {
        "tip_pos_world": np.asarray(start.pos_world),
        "tip_quat_world": np.asarray(start.quat_world),
        "tip_linvel_world": np.zeros(3),
        "tip_angvel_world": np.zeros(3),
        "wrench_sensor": np.tile(rollout.felt.tare_sensor, (SUBSTEPS, 1)),
        "contact": np.array(False),
    }
