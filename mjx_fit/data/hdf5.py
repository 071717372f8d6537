"""Encode and decode shards: stacked episodes as HDF5, each field with unit, frame, shape and meaning.

Equal episodes give equal bytes: files contain no time stamps and use gzip, since the output of lzf depends on
uninitialised memory. Files are encoded and decoded in memory, so that full disks and damaged files are
handled outside the HDF5 library, and the decoded bytes are the verified ones.
"""

import io
import json
from dataclasses import replace
from typing import Any

import h5py
import numpy as np

from mjx_fit.config.schema import Config, config_from_stored
from mjx_fit.data import hdf5_check_layout, hdf5_check_values
from mjx_fit.data.episode import Episode, unknown_truth
from mjx_fit.data.hdf5_fields import PHYSICS, START, Kind, fields_of, kind_of
from mjx_fit.data.manifest import FORMAT, Shard
from mjx_fit.data.schedule import stored_policies
from mjx_fit.scene.robot import ROBOTS
from mjx_fit.sensors.force_torque import touched
from mjx_fit.types import Felt, Rollout, StartPose, Trace, Truth
from mjx_fit.types.physics import Physics
from mjx_fit.utils.rates import ACTION_S

_HDF5 = ("v108", "v110")
"""Oldest and newest HDF5 file format to use; "latest" would depend on the installed library."""

FRAMES = (
    "world: origin on the table under the robot's base, x away from the robot, z up. "
    "sensor: between the hand and the peg, turned as the hand is, z along the tool: down, in an attempt. "
    "Forces and torques are what the arm exerts on the peg, torques about the sensor's origin."
)

_OWN = ("episode", "sequence", "number", "policy", "estimate_cov")
"""Fields of the episode; all others belong to its rollout."""

_FELT = ("length", "tare_sensor", "estimate_world", "peg_type")

CONTACT = "trace/contact"
"""Contact flag, derived from the wrenches: written for other readers, checked but not used here."""


def encode(episodes: Episode, request: dict[str, Any]) -> bytes:
    """Encode a shard as the content of a file.

    Args:
        episodes: Stacked episodes (n,), as NumPy arrays.
        request: Request of the data set, stored in the shard to make it self-describing.
    """
    config = config_from_stored(request["config"])
    values = flat(episodes, config, kind_of(request))
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", libver=_HDF5) as file:
        file.attrs["format"] = FORMAT
        file.attrs["shapes"] = list(config.scene.names)
        file.attrs["policies"] = list(stored_policies(request["policy"]))
        file.attrs["frames"], file.attrs["action_s"] = FRAMES, ACTION_S
        file.attrs["request"] = json.dumps(request)
        for name, field in fields_of(config, kind_of(request)).items():
            value = values[name]
            # One chunk per episode of a trace: a single episode can be read without unpacking others.
            chunks = (1, *value.shape[1:]) if name.startswith("trace/") else value.shape
            dataset = file.create_dataset(
                name,
                data=value,
                chunks=chunks,
                compression="gzip",
                compression_opts=1,
                shuffle=True,
                track_times=False,
            )
            dataset.attrs.update(field._asdict())
    return buffer.getvalue()


def decode(content: bytes, shard: Shard, request: dict[str, Any]) -> Episode:
    """Decode the output of ``encode``; reject any other file before reading data from it.

    Args:
        content: Content of the file, whose digest has been verified.
        shard: Entry of the shard in the manifest.
        request: Request of the data set.

    Raises:
        ValueError: The content is not that of the shard.
    """
    config = config_from_stored(request["config"])
    scene, shapes = config.scene, _shapes(shard.episodes, request)
    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            hdf5_check_layout.require(file, shapes, len(content))
            fields = {name: np.asarray(file[name]) for name in shapes}
    except hdf5_check_layout.LayoutError:
        raise
    except (OSError, LookupError, RuntimeError, ValueError, TypeError, AttributeError) as error:
        raise ValueError(f"it is not a shard: {' '.join(str(error).split())[:120]}") from None
    contact = fields.pop(CONTACT)
    episodes = _from_fields(fields, config)
    hdf5_check_values.require_flags(contact, shard.first_episode)
    counts = {"types": scene.n_types, "policies": len(stored_policies(request["policy"]))}
    unknown = kind_of(request).unknown
    hdf5_check_values.require(episodes, shard.first_episode, request["sequence"], **counts, unknown=unknown)
    return episodes


def flat(episodes: Episode, config: Config, kind: Kind) -> dict[str, np.ndarray]:
    """Return the fields by their names in a file."""
    contact = touched(episodes.rollout.felt, config.wrist)
    return {name: contact if name == CONTACT else _get(episodes, name) for name in fields_of(config, kind)}


def _shapes(n: int, request: dict[str, Any]) -> dict[str, hdf5_check_layout.Shape]:
    """Return the shape of each field for n episodes."""
    config = config_from_stored(request["config"])
    axes = {"n": n, "J": request["steps"], "joints": len(ROBOTS[config.scene.robot].joints)}
    return {
        name: tuple(axes[axis] if axis in axes else int(axis) for axis in field.shape.split())
        for name, field in fields_of(config, kind_of(request)).items()
    }


def _get(episodes: Episode, name: str) -> np.ndarray:
    rollout, last = episodes.rollout, name.rpartition("/")[2]
    if name.startswith("trace/"):
        value: Any = rollout.felt.trace
    elif name.startswith(PHYSICS):
        value = rollout.truth.physics
    elif name.startswith(START):
        value = rollout.felt.start
    else:
        value = episodes if name in _OWN else rollout.felt if name in _FELT else rollout.truth
    return np.asarray(getattr(value, last))


def _from_fields(fields: dict[str, np.ndarray], config: Config) -> Episode:
    own: dict[str, Any] = {name: fields.pop(name) for name in _OWN}
    felt: dict[str, Any] = {name: fields.pop(name) for name in _FELT}
    trace, drawn, start = (
        {name.removeprefix(group): fields.pop(name) for name in list(fields) if name.startswith(group)}
        for group in ("trace/", PHYSICS, START)
    )
    if start:  # a robot's
        truth = replace(unknown_truth(len(own["episode"]), config), **fields)
        felt["start"] = StartPose(**start)
    else:
        truth = Truth(**fields, physics=Physics(**drawn))
    return Episode(**own, rollout=Rollout(Felt(Trace(**trace), **felt), truth))
