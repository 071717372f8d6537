"""Interactions on disk: HDF5 shards of stacked episodes, and a manifest.

A shard is written under a temporary name, synced and renamed; the manifest is written anew after each shard
and names the shards that are complete with their SHA-256. So whatever the manifest names is there and whole,
and a killed collection goes on behind it.
"""

import json
from pathlib import Path
from typing import Any

import h5py
import jax
import numpy as np
from jaxtyping import Int

from mjx_fit import config as config_
from mjx_fit import files, provenance
from mjx_fit.config import Config
from mjx_fit.errors import RequestError
from mjx_fit.shapes import NAMES
from mjx_fit.types import Array, Interaction, Trace

MANIFEST = "manifest.json"
FORMAT = 1

FIELDS = {
    "trace/wrench_sensor": (
        "N, N·m",
        "sensor",
        "clean, of the arm on the peg, 500 Hz, weight included",
    ),
    "trace/tip_pos_world": ("m", "world", "centre of the peg's lower face at the end of each action"),
    "trace/tip_quat_world": ("1", "world", "its orientation, w x y z"),
    "trace/tip_linvel_world": ("m/s", "world", "its linear velocity"),
    "trace/tip_angvel_world": ("rad/s", "world", "its angular velocity"),
    "trace/contact": ("1", "-", "whether a contact force acted during the action"),
    "trace/action_world": ("m", "world", "desired change of the tip's position"),
    "length": ("1", "-", "number of actions performed; rows behind it are padding"),
    "inserted": ("1", "-", "whether the peg was inserted"),
    "peg_type": ("1", "-", "index into shapes"),
    "hole_type": ("1", "-", "index into shapes"),
    "hole_pos_world": ("m", "world", "true centre of the hole"),
    "estimate_world": ("m", "world", "estimate over which the interaction started"),
    "tare_sensor": ("N, N·m", "sensor", "clean reading at rest in free space before the interaction"),
    "end_qpos": ("rad", "-", "joint angles at the end; where it broke, before the action that broke it"),
    "end_qvel": ("rad/s", "-", "joint velocities at the same moment"),
    "valid": ("1", "-", "false where the simulation turned non-finite"),
}
"""Unit, frame and meaning of each data set of a shard."""


class Writer:
    """Writes the shards of one collection into a folder, or goes on where another writer was stopped.

    Args:
        folder: Where to; made if it is not there.
        request: What makes this collection what it is, JSON-ready.
        config: The resolved configuration.

    Raises:
        RequestError: The folder holds something else.
    """

    def __init__(self, folder: Path, request: dict[str, Any], config: Config):
        self._folder = folder
        request = request | {"config": config_.to_tree(config)}
        if folder.exists() and not folder.is_dir():
            raise RequestError(f"--out: {folder} is not allowed: it must be a folder")
        if (folder / MANIFEST).is_file():
            self._manifest = read_manifest(folder)
            _require_same(folder, self._manifest["request"], request)
            if not self._manifest["complete"]:  # other versions may compute other bytes
                _require_same(folder, self._manifest, {"versions": provenance.versions()})
        else:
            there = {path.name for path in folder.iterdir()} if folder.is_dir() else set()
            foreign = sorted(there - {f"{MANIFEST}.tmp"})  # a kill may have left that
            if foreign:
                raise RequestError(f"--out: {folder} is not allowed: it holds other files ({foreign[0]})")
            self._manifest = {
                "format": FORMAT,
                "request": request,
                "versions": provenance.versions(),
                "device": provenance.device(),
                "shapes": list(NAMES),
                "complete": False,
                "shards": [],
            }
            folder.mkdir(parents=True, exist_ok=True)
            self._save()

    def has(self, name: str) -> bool:
        """Whether a shard is there, whole."""
        shard = next((shard for shard in self._manifest["shards"] if shard["name"] == name), None)
        path = self._folder / name
        return shard is not None and path.is_file() and files.sha256(path) == shard["sha256"]

    def write(self, name: str, episodes: Int[np.ndarray, "n"], interactions: Interaction) -> None:
        """Adds or replaces a shard.

        Args:
            name: Its file name.
            episodes: Ids of its episodes.
            interactions: The episodes, stacked.
        """
        path = self._folder / name
        files.replace_with(path, lambda temporary: _write_shard(temporary, episodes, interactions))
        shards = [shard for shard in self._manifest["shards"] if shard["name"] != name]
        shards.append({"name": name, "episodes": episodes.tolist(), "sha256": files.sha256(path)})
        self._manifest["shards"] = sorted(shards, key=lambda shard: shard["name"])
        self._save()

    def finish(self) -> None:
        """Notes that all shards are there. A finished collection is not touched again."""
        if not self._manifest["complete"]:
            self._manifest["complete"] = True
            self._save()

    def _save(self) -> None:
        files.write_text(self._folder / MANIFEST, json.dumps(self._manifest, indent=1) + "\n")


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a data set.

    Raises:
        RequestError: The folder is not there, or holds no data set.
    """
    if not folder.is_dir():
        raise RequestError(f"data: {folder} is not allowed: there is no such folder")
    try:
        manifest = json.loads((folder / MANIFEST).read_text())
        if manifest["format"] != FORMAT:
            raise RequestError(
                f"data: {folder} is not allowed: its format is {manifest['format']}, not {FORMAT}"
            )
        if not isinstance(manifest["shards"], list) or not isinstance(manifest["request"], dict):
            raise TypeError
    except FileNotFoundError:
        raise RequestError(
            f"data: {folder} is not allowed: it holds no {MANIFEST}, so it is no data set"
        ) from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        if isinstance(error, RequestError):
            raise
        raise RequestError(f"data: {folder} is not allowed: its {MANIFEST} cannot be read") from None
    return manifest


def load(folder: Path) -> Interaction:
    """All valid interactions of a data set, stacked in the order of their episode ids, as NumPy arrays.

    Raises:
        RequestError: The folder holds no data set, an unfinished one, or a damaged shard.
    """
    manifest = read_manifest(folder)
    if not manifest["complete"]:
        raise RequestError(f"data: {folder} is not allowed: it is not complete; repeat its collect command")
    parts = [_read_shard(folder / shard["name"], shard["sha256"]) for shard in manifest["shards"]]
    ids = np.concatenate([np.asarray(shard["episodes"]) for shard in manifest["shards"]])
    order = np.argsort(ids, kind="stable")
    stacked = jax.tree.map(lambda *leaves: np.concatenate(leaves)[order], *parts)
    return jax.tree.map(lambda leaf: leaf[stacked.valid], stacked)


def describe(folder: Path) -> dict[str, Any]:
    """What a data set holds: episodes, steps, pairs, success rate, units, engine, seed; JSON-ready.

    Raises:
        RequestError: As in ``load``.
    """
    manifest, data = read_manifest(folder), load(folder)
    request = manifest["request"]
    pairs: dict[str, dict[str, int]] = {}
    for peg, hole, inserted in zip(data.peg_type, data.hole_type, data.inserted, strict=True):
        row = pairs.setdefault(f"{NAMES[peg]}-{NAMES[hole]}", {"episodes": 0, "inserted": 0})
        row["episodes"] += 1
        row["inserted"] += int(inserted)
    matched = data.peg_type == data.hole_type
    stored = sum(len(shard["episodes"]) for shard in manifest["shards"])
    return {
        "episodes": stored,
        "invalid": stored - len(data.length),
        "steps": request["steps"],
        "actions": int(data.length.sum()),
        "pairs": dict(sorted(pairs.items())),
        "success_rate": {
            "matched": _mean(data.inserted[matched]),
            "mismatched": _mean(data.inserted[~matched]),
        },
        "units": {name: unit for name, (unit, _, _) in FIELDS.items()},
        "engine": request["engine"],
        "policy": request["policy"],
        "seed": request["seed"],
        "device": manifest["device"],
        "shards": len(manifest["shards"]),
    }


def _mean(values: Array) -> float | None:
    return float(values.mean()) if len(values) else None


def _require_same(folder: Path, there: dict[str, Any], here: dict[str, Any]) -> None:
    for name, value in here.items():
        if there.get(name) != value:
            detail = "" if isinstance(value, dict) else f": {there.get(name)!r} there, {value!r} here"
            raise RequestError(
                f"--out: {folder} is not allowed: it holds another run (its {name} differs{detail})"
            )


def _write_shard(path: Path, episodes: np.ndarray, interactions: Interaction) -> None:
    # Equal data gives equal bytes: no time stamps; gzip, since lzf's output depends on what lay in memory.
    with h5py.File(path, "w", libver="latest") as file:
        file.attrs["format"] = FORMAT
        file.attrs["shapes"] = list(NAMES)
        file.create_dataset("episode", data=episodes.astype(np.int64), track_times=False)
        for name, (unit, frame, meaning) in FIELDS.items():
            dataset = file.create_dataset(
                name,
                data=_field(interactions, name),
                compression="gzip",
                compression_opts=1,
                shuffle=True,
                track_times=False,
            )
            dataset.attrs.update(unit=unit, frame=frame, meaning=meaning)


def _read_shard(path: Path, sha256: str) -> Interaction:
    try:
        if files.sha256(path) != sha256:
            raise ValueError("its SHA-256 is not the manifest's")
        with h5py.File(path, "r") as file:
            fields = {name: np.asarray(file[name]) for name in FIELDS}
    except (OSError, KeyError, ValueError) as error:
        raise RequestError(f"data: {path.name} in {path.parent} is damaged or missing: {error}") from None
    trace = {
        name.removeprefix("trace/"): value for name, value in fields.items() if name.startswith("trace/")
    }
    rest = {name: value for name, value in fields.items() if not name.startswith("trace/")}
    return Interaction(trace=Trace(**trace), **rest)


def _field(interactions: Interaction, name: str) -> np.ndarray:
    value: Any = interactions
    for part in name.split("/"):
        value = getattr(value, part)
    return np.asarray(value)
