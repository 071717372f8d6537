"""Encode and decode shards: stacked episodes as HDF5, each field with unit, frame, shape and meaning.

Equal episodes give equal bytes: files contain no time stamps and use gzip, since the output of lzf depends on
uninitialised memory. Files are encoded and decoded in memory, so that full disks and damaged files are
handled outside the HDF5 library, and the decoded bytes are the verified ones.
"""

import io
import json
from typing import Any, NamedTuple

import h5py
import numpy as np

from mjx_fit.config.quantities import QUANTITIES
from mjx_fit.config.randomized import distributions
from mjx_fit.config.schema import Config, config_from_stored
from mjx_fit.data import hdf5_check_layout, hdf5_check_values
from mjx_fit.data.episode import Episode
from mjx_fit.data.manifest import FORMAT, Shard
from mjx_fit.data.schedule import stored_policies
from mjx_fit.scene.placement import GRASP
from mjx_fit.scene.robot import ROBOTS
from mjx_fit.sensors.force_torque import touched
from mjx_fit.types import Felt, Rollout, Trace, Truth
from mjx_fit.types.physics import Physics
from mjx_fit.utils.rates import ACTION_S


class Field(NamedTuple):
    """Metadata of a field.

    Attributes:
        unit: Unit of the values; several if the columns differ.
        frame: Reference frame of the values.
        shape: Axes, for n episodes of J actions.
        meaning: Description of the values.
    """

    unit: str
    frame: str
    shape: str
    meaning: str


FIELDS = {
    "episode": Field("1", "-", "n", "id"),
    "sequence": Field("1", "-", "n", "id of a row of attempts of one peg at one hole"),
    "number": Field("1", "-", "n", "which attempt of its sequence it is, from 0"),
    "policy": Field("1", "-", "n", "index into policies"),
    "estimate_cov": Field(
        "m²", "world", "n 2 2", "covariance of estimate_world as it was believed before the interaction"
    ),
    "trace/wrench_sensor": Field(
        "N, N·m",
        "sensor",
        "n J 50 6",
        "force and torque of the arm on the peg: clean, 500 Hz, weight included",
    ),
    "trace/tip_pos_world": Field(
        "m", "world", "n J 3", "centre of the peg's lower face at the end of each action"
    ),
    "trace/tip_quat_world": Field("1", "world", "n J 4", "orientation of the tip, w x y z"),
    "trace/tip_linvel_world": Field("m/s", "world", "n J 3", "linear velocity of the tip"),
    "trace/tip_angvel_world": Field("rad/s", "world", "n J 3", "angular velocity of the peg"),
    "trace/contact": Field("1", "-", "n J", "whether the force, tared, says so: wrist.contact_force_n"),
    "trace/action_world": Field("m", "world", "n J 3", "desired change of the tip's position"),
    "length": Field(
        "1",
        "-",
        "n",
        "number of actions performed; rows behind it are padding; 0: its sequence had ended before",
    ),
    "inserted": Field("1", "-", "n", "whether the peg was inserted"),
    "peg_type": Field("1", "-", "n", "index into shapes"),
    "hole_type": Field("1", "-", "n", "index into shapes"),
    "hole_pos_world": Field("m", "world", "n 2", "true centre of the hole"),
    "estimate_world": Field("m", "world", "n 2", "estimate over which the interaction started"),
    "tare_sensor": Field(
        "N, N·m", "sensor", "n 6", "clean reading at rest in free space before the interaction"
    ),
    "end_qpos": Field(
        "rad", "-", "n joints", "joint angles at the end; where it broke, before the action that broke it"
    ),
    "end_qvel": Field("rad/s", "-", "n joints", "joint velocities at the end"),
    "valid": Field("1", "-", "n", "false where the simulation turned non-finite"),
}

_TURNS = {
    "trace/turn_world": Field(
        "rad",
        "world",
        "n J 3",
        "desired orientation at the end of the action: rotation vector from straight down",
    )
}

PHYSICS = "physics/"
"""Group of the quantities that each world drew for itself; only those with a distribution are stored."""


def fields_of(config: Config, *, turns: bool) -> dict[str, Field]:
    """Return the fields of a data set: those of every data set, and the physics that its worlds drew.

    Args:
        config: The configuration; ``filter.coordinates`` gives estimates their axes.
        turns: Whether commands turn the TCP, as ``turns`` of the request tells.
    """
    fields, d = dict(FIELDS), len(config.filter.coordinates)
    if turns:
        fields |= _TURNS
    if d > 2:
        named = f"as filter.coordinates: {', '.join(config.filter.coordinates)}"
        for name, shape, unit in (
            ("estimate_world", f"n {d}", "m, rad"),
            ("estimate_cov", f"n {d} {d}", "m², rad²"),
        ):
            meaning = f"{FIELDS[name].meaning}, {named}"
            fields[name] = FIELDS[name]._replace(shape=shape, unit=unit, meaning=meaning)
    own = {name: f"drawn from randomize.{name}" for name in distributions(config.randomize)}
    if config.placement.slips:
        own |= dict.fromkeys(GRASP, "the grasp at the end of the attempt")
    units = {name: QUANTITIES[name].unit for name in own}
    own = {f"{PHYSICS}{name}": Field(units[name], "-", "n", meaning) for name, meaning in own.items()}
    return fields | own


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
    values = flat(episodes, config)
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", libver=_HDF5) as file:
        file.attrs["format"] = FORMAT
        file.attrs["shapes"] = list(config.scene.names)
        file.attrs["policies"] = list(stored_policies(request["policy"]))
        file.attrs["frames"], file.attrs["action_s"] = FRAMES, ACTION_S
        file.attrs["request"] = json.dumps(request)
        for name, field in fields_of(config, turns=request.get("turns", False)).items():
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
    episodes = _from_fields(fields)
    hdf5_check_values.require_flags(contact, shard.first_episode)
    counts = {"types": scene.n_types, "policies": len(stored_policies(request["policy"]))}
    hdf5_check_values.require(episodes, shard.first_episode, request["sequence"], **counts)
    return episodes


def flat(episodes: Episode, config: Config) -> dict[str, np.ndarray]:
    """Return the fields by their names in a file."""
    contact, turns = touched(episodes.rollout.felt, config.wrist), _turns(episodes)
    return {
        name: contact if name == CONTACT else _get(episodes, name) for name in fields_of(config, turns=turns)
    }


def _turns(episodes: Episode) -> bool:
    return episodes.rollout.felt.trace.turn_world is not None


def _shapes(n: int, request: dict[str, Any]) -> dict[str, hdf5_check_layout.Shape]:
    """Return the shape of each field for n episodes."""
    config = config_from_stored(request["config"])
    axes = {"n": n, "J": request["steps"], "joints": len(ROBOTS[config.scene.robot].joints)}
    return {
        name: tuple(axes[axis] if axis in axes else int(axis) for axis in field.shape.split())
        for name, field in fields_of(config, turns=request.get("turns", False)).items()
    }


def _get(episodes: Episode, name: str) -> np.ndarray:
    rollout, last = episodes.rollout, name.rpartition("/")[2]
    if name.startswith("trace/"):
        value: Any = rollout.felt.trace
    elif name.startswith(PHYSICS):
        value = rollout.truth.physics
    else:
        value = episodes if name in _OWN else rollout.felt if name in _FELT else rollout.truth
    return np.asarray(getattr(value, last))


def _from_fields(fields: dict[str, np.ndarray]) -> Episode:
    own: dict[str, Any] = {name: fields.pop(name) for name in _OWN}
    felt: dict[str, Any] = {name: fields.pop(name) for name in _FELT}
    trace, drawn = (
        {name.removeprefix(group): fields.pop(name) for name in list(fields) if name.startswith(group)}
        for group in ("trace/", PHYSICS)
    )
    truth = Truth(**fields, physics=Physics(**drawn))
    return Episode(**own, rollout=Rollout(Felt(Trace(**trace), **felt), truth))
