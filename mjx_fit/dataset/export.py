"""A data set as one file that others read: NumPy's npz, or HDF5 laid out as robomimic's demonstrations."""

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import jax
import numpy as np

from mjx_fit import config as config_
from mjx_fit import files, locks
from mjx_fit.dataset import manifest as manifest_
from mjx_fit.dataset.episode import Episode, happened
from mjx_fit.dataset.manifest import Manifest
from mjx_fit.dataset.shard import FIELDS, flat
from mjx_fit.dataset.store import load, read_shards
from mjx_fit.errors import RequestError
from mjx_fit.policies import POLICIES
from mjx_fit.progress import Progress
from mjx_fit.shapes import plate_top_m
from mjx_fit.simulate.engine import START_HEIGHT_M
from mjx_fit.types import SUBSTEPS, Interaction

_STATE = (
    "tip_pos_world",
    "tip_quat_world",
    "tip_linvel_world",
    "tip_angvel_world",
    "wrench_sensor",
    "contact",
)
"""What the robot observes once an action is done."""


def export(folder: Path, out: Path) -> None:
    """Writes a data set into one file, ``.npz`` or ``.hdf5``.

    Episodes that did not happen or broke are left out. The HDF5 file is made in memory: the HDF5 library does
    not survive a disk that is full.

    Args:
        folder: Of the data set.
        out: The file; what was there is replaced.

    Raises:
        RequestError: The data set cannot be read, or the file has another ending.
    """
    writers: dict[str, Callable[[Path, Manifest, Path], None]] = {
        ".npz": _write_npz,
        ".hdf5": _write_robomimic,
    }
    if out.suffix not in writers:
        raise RequestError(f"--out: {out} is not allowed: it must end in one of {', '.join(writers)}")
    if out.is_dir():
        raise RequestError(f"--out: {out} is not allowed: it is a folder")
    manifest = manifest_.read_complete(folder)
    with locks.holding_file(out):
        files.replace_with(out, lambda temporary: writers[out.suffix](folder, manifest, temporary))


def _write_npz(folder: Path, manifest: Manifest, path: Path) -> None:
    data = load(folder)
    keep = happened(data)
    arrays: dict[str, Any] = {name.replace("/", "_"): value[keep] for name, value in flat(data).items()}
    about = {name.replace("/", "_"): field._asdict() for name, field in FIELDS.items()}
    about |= {"shapes": list(manifest.shapes), "request": manifest.request, "versions": manifest.versions}
    with path.open("wb") as file:  # given a name, savez would add .npz to the temporary one
        np.savez_compressed(file, about=np.array(json.dumps(about)), **arrays)


def _write_robomimic(folder: Path, manifest: Manifest, path: Path) -> None:
    """One group ``data/demo_<episode>`` for each episode.

    ``obs`` row t is before action t and ``next_obs`` after it, each with the wrenches (50, 6) of the action
    before. Before the first action the robot is at rest, straight down over the estimate.
    """
    top = plate_top_m(config_.from_tree(manifest.request["config"]).scene)
    total, buffer = 0, io.BytesIO()
    with h5py.File(buffer, "w") as file, Progress("export: shard", len(manifest.shards)) as progress:
        root = file.create_group("data", track_order=True)
        root.attrs["env_args"] = json.dumps({"env_name": "mjx_fit", "env_kwargs": manifest.request})
        for done, shard in enumerate(read_shards(folder, manifest.shards, manifest.request), 1):
            for row in np.flatnonzero(happened(shard)):
                episode = jax.tree.map(lambda leaf, row=row: leaf[row], shard)
                total += _add_demonstration(root, episode, top, manifest.shapes)
            progress(done)
        root.attrs["total"] = total
    path.write_bytes(buffer.getbuffer())


def _add_demonstration(root: h5py.Group, episode: Episode, plate_top: float, names: tuple[str, ...]) -> int:
    interaction = episode.interaction
    n = int(interaction.length)
    demo = root.create_group(f"demo_{int(episode.episode)}")
    demo.attrs["num_samples"] = n
    for name in ("peg_type", "hole_type"):
        demo.attrs[name] = names[int(getattr(interaction, name))]
    demo.attrs["inserted"], demo.attrs["policy"] = bool(interaction.inserted), POLICIES[int(episode.policy)]
    for name in ("hole_pos_world", "estimate_world", "tare_sensor"):
        demo.attrs[name] = getattr(interaction, name)
    demo.attrs["sequence"], demo.attrs["number"] = int(episode.sequence), int(episode.number)
    demo.attrs["estimate_cov"] = episode.estimate_cov
    ended = np.arange(n) == n - 1
    demo["actions"] = interaction.trace.action_world[:n]
    demo["rewards"] = (ended & interaction.inserted).astype(np.float32)
    demo["dones"] = ended.astype(np.int64)
    first = _at_rest(interaction, plate_top)
    for name in _STATE:
        after = getattr(interaction.trace, name)[:n]
        before = np.concatenate([np.asarray(first[name], after.dtype)[None], after[:-1]])
        for group, rows in (("obs", before), ("next_obs", after)):
            demo.create_dataset(f"{group}/{name}", data=rows, compression="gzip", compression_opts=1)
    return n


def _at_rest(interaction: Interaction, plate_top: float) -> dict[str, np.ndarray]:
    return {
        "tip_pos_world": np.append(interaction.estimate_world, plate_top + START_HEIGHT_M),
        "tip_quat_world": np.array([0.0, 1.0, 0.0, 0.0]),
        "tip_linvel_world": np.zeros(3),
        "tip_angvel_world": np.zeros(3),
        "wrench_sensor": np.tile(interaction.tare_sensor, (SUBSTEPS, 1)),
        "contact": np.array(False),
    }
