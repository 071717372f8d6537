"""MCAP with messages of ROS 2, for Foxglove and for ``mjx-fit log import``.

The attempts of a data set follow each other, ``APART_S`` apart. Each begins with ``REST_S`` of rest above the
hole, in which the sensor reads its tare. Wrenches are those of the arm on the peg, in the sensor's frame.
"""

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mjx_fit.config.schema import Config, config_from_stored
from mjx_fit.data.exports.recording import Recording, recordings, truth_of
from mjx_fit.data.manifest import Manifest
from mjx_fit.utils.progress import Progress
from mjx_fit.utils.rates import ACTION_S, STEP_S

try:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore
except ImportError:
    raise ImportError("MCAP needs rosbags, which is not installed: pip install 'mjx-fit[logs]'") from None

APART_S = 1.0
REST_S = 0.5
START_S = 1.0
NO_ATTEMPT = -1

_STORE = get_typestore(Stores.ROS2_HUMBLE)
_TOPICS = {
    "/wrench": "geometry_msgs/msg/WrenchStamped",
    "/tcp_pose": "geometry_msgs/msg/PoseStamped",
    "/tcp_twist": "geometry_msgs/msg/TwistStamped",
    "/command": "geometry_msgs/msg/Vector3Stamped",
    "/command_turn": "geometry_msgs/msg/Vector3Stamped",
    "/attempt": "std_msgs/msg/Int32",
    "/peg": "std_msgs/msg/String",
    "/estimate": "std_msgs/msg/Float64MultiArray",
    "/truth/hole": "geometry_msgs/msg/PointStamped",
    "/truth/type": "std_msgs/msg/String",
    "/truth/place": "geometry_msgs/msg/PointStamped",
    "/truth/inserted": "std_msgs/msg/Bool",
}


class _Sample(NamedTuple):
    time_s: float
    topic: str
    message: Any


def map_of(manifest: Manifest) -> dict[str, Any]:
    """Return the map of a data set's file (``mjx_fit.data.logs.log_map``)."""
    config = config_from_stored(manifest.request["config"])
    return {
        "wrench": {
            "source": "/wrench",
            "acts_on": "peg",
            "sensor_in_tool": {"position_m": [0.0, 0.0, -config.scene.peg_length_m]},
        },
        "pose": {"source": "/tcp_pose"},
        "twist": {"source": "/tcp_twist"},
        "command": {"source": "/command"},
        "attempts": {
            "by": "column",
            "source": "/attempt",
            "peg_source": "/peg",
            "estimate_source": "/estimate",
            "tare_s": REST_S - 0.1,
        },
        **truth_of(manifest, "/truth/type", "/truth/place", "/truth/inserted"),
    }


def write_mcap(folder: Path, manifest: Manifest, path: Path) -> None:
    """Write the attempts of a data set."""
    config = config_from_stored(manifest.request["config"])
    begin_s = START_S
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".export-") as own:
        bag = Path(own) / "bag"
        with (
            Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer,
            Progress("export: shard", len(manifest.shards)) as progress,
        ):
            topics = {
                topic: writer.add_connection(topic, kind, typestore=_STORE) for topic, kind in _TOPICS.items()
            }
            for done, attempts in enumerate(recordings(folder, manifest), 1):
                for one in attempts:
                    begin_s += REST_S
                    for at_s, topic, message in _samples(one, begin_s, config):
                        content = _STORE.serialize_cdr(message, _TOPICS[topic])
                        writer.write(topics[topic], _nanoseconds(at_s), content)
                    begin_s += ACTION_S * len(one.log.command_time_s) + APART_S
                progress(done)
        (file,) = bag.glob("*.mcap")
        shutil.copyfile(file, path)  # the file that is there is synced, so it has to stay


def _samples(one: Recording, begin_s: float, config: Config) -> list[_Sample]:
    """Return the messages of an attempt whose first action begins at this time, in order."""
    return sorted(_unsorted(one, begin_s, config), key=lambda sample: sample.time_s)


def _unsorted(one: Recording, begin_s: float, config: Config) -> Iterator[_Sample]:
    log = one.log
    rest = -STEP_S * np.arange(round(REST_S / STEP_S), 0, -1)
    tare = np.tile(np.asarray(log.tare_sensor), (len(rest), 1))
    wrenches = np.concatenate([tare, log.wrench_sensor])
    for at, wrench in zip(np.concatenate([rest, log.wrench_time_s]), wrenches, strict=True):
        message = _new("Wrench", force=_xyz(wrench[:3]), torque=_xyz(wrench[3:]))
        yield _stamped(begin_s + at, "/wrench", "sensor", wrench=message)
    yield from _motion(one, begin_s)
    for topic, values in (("/command", log.command_world), ("/command_turn", one.turn_world)):
        for at, value in zip(log.command_time_s, [] if values is None else values, strict=values is not None):
            yield _stamped(begin_s + at, topic, "base", vector=_xyz(value))
    end = ACTION_S * len(log.command_time_s)
    types = _STORE.types
    yield _Sample(begin_s, "/attempt", types["std_msgs/msg/Int32"](one.episode))
    yield _Sample(begin_s + end, "/attempt", types["std_msgs/msg/Int32"](NO_ATTEMPT))
    yield _Sample(begin_s, "/peg", types["std_msgs/msg/String"](one.peg))
    layout = types["std_msgs/msg/MultiArrayLayout"]([], 0)
    values = one.estimate.astype(np.float64)
    yield _Sample(begin_s, "/estimate", types["std_msgs/msg/Float64MultiArray"](layout, values))
    if one.truth is not None:
        for topic, place in (("/truth/hole", one.truth.hole_pos_world), ("/truth/place", one.place_world)):
            at = [*np.asarray(place, float), 0.0]
            yield _stamped(begin_s, topic, "base", point=_new("Point", *at))
        yield _Sample(begin_s, "/truth/type", types["std_msgs/msg/String"](one.hole or ""))
        yield _Sample(begin_s + end, "/truth/inserted", types["std_msgs/msg/Bool"](bool(one.truth.inserted)))


def _motion(one: Recording, begin_s: float) -> Iterator[_Sample]:
    """Yield poses and twists; the arm rests in the pose before the first action."""
    log = one.log
    assert log.tip_linvel_world is not None
    assert log.tip_angvel_world is not None
    for i, at in enumerate(np.concatenate([[-REST_S], log.pose_time_s])):
        row = max(i - 1, 0)
        w, x, y, z = log.tip_quat_world[row]
        turn = _new("Quaternion", float(x), float(y), float(z), float(w))
        place = _new("Point", *map(float, log.tip_pos_world[row]))
        yield _stamped(begin_s + at, "/tcp_pose", "base", pose=_new("Pose", place, turn))
        twist = _new("Twist", _xyz(log.tip_linvel_world[row]), _xyz(log.tip_angvel_world[row]))
        yield _stamped(begin_s + at, "/tcp_twist", "base", twist=twist)


def _new(kind: str, *values: Any, **named: Any) -> Any:
    return _STORE.types[f"geometry_msgs/msg/{kind}"](*values, **named)


def _xyz(vector: Any) -> Any:
    return _new("Vector3", *map(float, vector))


def _stamped(at_s: float, topic: str, frame: str, **content: Any) -> _Sample:
    seconds, rest = divmod(_nanoseconds(at_s), 10**9)
    stamp = _STORE.types["builtin_interfaces/msg/Time"](seconds, rest)
    header = _STORE.types["std_msgs/msg/Header"](stamp, frame)
    return _Sample(at_s, topic, _STORE.types[_TOPICS[topic]](header, **content))


def _nanoseconds(time_s: float) -> int:
    return round(1e9 * time_s)
