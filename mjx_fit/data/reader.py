"""Read a data set: its episodes, its damage and its summary."""

import errno
import os
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

from mjx_fit.config.schema import config_from_stored
from mjx_fit.data import hdf5
from mjx_fit.data.episode import Episode, happened
from mjx_fit.data.hdf5_fields import fields_of, kind_of
from mjx_fit.data.manifest import (
    MANIFEST_NAME,
    ROBOT,
    FormatError,
    Manifest,
    Shard,
    knows_truth,
    parse_manifest,
    read_complete_manifest,
    read_manifest,
    read_manifest_text,
)
from mjx_fit.sensors.force_torque import touched
from mjx_fit.types import Array, Felt, Rollout
from mjx_fit.utils import files
from mjx_fit.utils.errors import RequestError

_LOST = "the list of shards is lost; collect again into another folder"


def load(folder: Path, without: Collection[str] = ()) -> Episode:
    """Load all episodes of a data set, stacked in the order of their ids, as NumPy arrays.

    The result includes episodes that were not performed or diverged; see ``happened``.

    Args:
        folder: Folder of the data set.
        without: Names of shards to skip, such as those in ``damages``.

    Raises:
        RequestError: The folder holds no data set, an unfinished one or a damaged shard.
    """
    manifest = read_complete_manifest(folder)
    wanted = [shard for shard in manifest.shards if shard.name not in without]
    if not wanted:
        raise RequestError(f"data: {folder} cannot be used: every shard is excluded")
    stacked, row = None, 0
    for part in read_shards(folder, wanted, manifest.request):
        if stacked is None:
            # Filled in place: concatenation at the end would hold everything in memory twice.
            n = sum(shard.episodes for shard in wanted)
            stacked = jax.tree.map(lambda leaf, n=n: np.empty((n, *leaf.shape[1:]), leaf.dtype), part)
        rows = slice(row, row := row + len(part.episode))
        jax.tree.map(lambda to, leaf, rows=rows: to.__setitem__(rows, leaf), stacked, part)
    assert stacked is not None
    return stacked


def read_shards(folder: Path, shards: Collection[Shard], request: dict[str, Any]) -> Iterator[Episode]:
    """Yield the episodes of these shards, one shard at a time.

    Args:
        folder: Folder of the data set.
        shards: Entries of its manifest.
        request: Request of the data set.

    Raises:
        RequestError: A shard is damaged.
    """
    for shard in shards:
        try:
            yield hdf5.decode(content_of(folder, shard), shard, request)
        except (OSError, ValueError) as error:
            raise RequestError(f"data: {shard.name} in {folder} is damaged or missing: {error}") from None


def content_of(folder: Path, shard: Shard) -> bytes:
    """Return the content of a shard's file after checking its size and digest.

    Raises:
        OSError: It cannot be read.
        ValueError: Its size or digest differs from the manifest.
    """
    path = folder / shard.name
    if not path.is_file():  # a pipe or a device would never end
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), shard.name)
    size = path.stat().st_size
    if size == shard.bytes:  # before anything is read
        content = path.read_bytes()
        if files.sha256_of(content) == shard.sha256:
            return content
        raise ValueError("its SHA-256 is not the manifest's")
    raise ValueError(f"{size} bytes instead of {shard.bytes}")


def damages(folder: Path) -> dict[str, str]:
    """Return the damage of a data set: a description for each damaged file, by name.

    Raises:
        RequestError: The folder is not a data set, or has another format.
    """
    try:
        manifest = parse_manifest(read_manifest_text(folder))
    except FormatError as error:
        raise RequestError(f"data: {folder} cannot be used: {error}") from None
    except FileNotFoundError:
        if not list(folder.glob("shard-*.h5")):
            read_manifest(folder)  # says why this is no data set
        return {MANIFEST_NAME: f"missing: {_LOST}"}
    except (OSError, ValueError) as error:
        return {MANIFEST_NAME: f"damaged ({error}): {_LOST}"}
    found = {shard.name: _damage(folder, shard, manifest) for shard in manifest.shards}
    # A collection in progress may have one shard that its manifest does not list yet.
    for path in sorted(folder.glob("*.h5")) if manifest.complete else ():
        found.setdefault(path.name, "foreign: the manifest does not list it; remove it")
    return {name: what for name, what in found.items() if what}


def _damage(folder: Path, shard: Shard, manifest: Manifest) -> str:
    path = folder / shard.name
    if not path.is_file():
        return "missing"
    try:
        hdf5.decode(content_of(folder, shard), shard, manifest.request)
        return ""
    except OSError as error:
        return f"cannot be read: {error.strerror}"
    except ValueError as error:
        what = str(error)
    digest = files.sha256(path)
    twins = [one.name for one in manifest.shards if one.sha256 == digest and one.name != shard.name]
    return f"swapped: it holds the content of {twins[0]}" if twins else f"damaged: {what}"


def describe(folder: Path) -> dict[str, Any]:
    """Summarise a data set: episodes, actions, pairs, success rates, units, engine, seed; JSON-ready.

    One of a robot has its logs and pegs, and pairs and success rates only if its logs were labelled.

    Raises:
        RequestError: As in ``load``.
    """
    manifest, data = read_manifest(folder), load(folder)
    request = manifest.request
    keep = happened(data)
    done: Rollout = jax.tree.map(lambda leaf: leaf[keep], data.rollout)
    config, felt = config_from_stored(request["config"]), done.felt
    robots = request["engine"] == ROBOT
    return {
        "policy": request["policy"],
        "engine": request["engine"],
        "seed": request["seed"],
        "episodes": len(keep),
        "sequences": len(np.unique(data.sequence)),
        "not_performed": int((data.rollout.felt.length == 0).sum()),
        "invalid": int((~data.rollout.truth.valid).sum()),
        "steps": request["steps"],
        "actions": int(felt.length.sum()),
        "contact_fraction": _mean(touched(felt, config.wrist)[_real(felt.length, request["steps"])]),
        **(_logs(manifest, felt) if robots else {}),
        **(_outcomes(manifest, done) if knows_truth(request) else {}),
        "part": "{} of {}".format(*manifest.part),
        "shards": len(manifest.shards),
        "bytes": sum(shard.bytes for shard in manifest.shards),
        "devices": sorted({shard.device for shard in manifest.shards}),
        "units": {name: field.unit for name, field in fields_of(config, kind_of(request)).items()},
    }


def _logs(manifest: Manifest, felt: Felt) -> dict[str, Any]:
    """Return what is known of a robot's attempts."""
    count, logs = np.bincount(felt.peg_type, minlength=len(manifest.shapes)), Counter()
    for log in manifest.request["logs"]:  # files in several folders may share a name
        logs[log["name"]] += len(log["attempts"])
    return {
        "logs": dict(logs),
        "pegs": {name: int(n) for name, n in zip(manifest.shapes, count, strict=True) if n},
    }


def _outcomes(manifest: Manifest, done: Rollout) -> dict[str, Any]:
    """Return the success rates of simulated attempts, and the counts of each pair."""
    felt, truth = done.felt, done.truth
    pairs: dict[str, dict[str, int]] = {}
    for peg, hole, succeeded, wrong in zip(
        felt.peg_type, truth.hole_type, done.succeeded, done.inserted_wrongly, strict=True
    ):
        name = f"{manifest.shapes[peg]}-{manifest.shapes[hole]}"
        row = pairs.setdefault(name, {"episodes": 0, "inserted": 0})
        row["episodes"] += 1
        row["inserted"] += int(succeeded)
        if wrong:
            row["inserted_wrongly"] = row.get("inserted_wrongly", 0) + 1
    matched = np.asarray(felt.peg_type == truth.hole_type)
    wrongly = done.inserted_wrongly[~matched]
    return {
        "success_rate": {
            "matched": _mean(done.succeeded[matched]),
            "mismatched": _mean(done.succeeded[~matched]),
        },
        **({"inserted_wrongly": _mean(wrongly)} if wrongly.any() else {}),
        "pairs": dict(sorted(pairs.items())),
    }


def _real(length: Array, steps: int) -> Array:
    """Mask of the performed actions, (n, J)."""
    return np.arange(steps) < np.asarray(length)[:, None]


def _mean(values: Array) -> float | None:
    return round(float(values.mean()), 4) if len(values) else None
