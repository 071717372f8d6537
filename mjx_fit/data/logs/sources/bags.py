"""Bags of ROS 1 and ROS 2 (also as MCAP), read without an installation of ROS."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from mjx_fit.data.logs.log_map import LogMap, PoseMap
from mjx_fit.data.logs.raw_log import SECONDS, Labels, RawLog, Stream
from mjx_fit.utils.errors import RequestError, shortened, shown

try:
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import Stores, get_typestore
except ImportError:
    raise ImportError("bags need rosbags, which is not installed: pip install 'mjx-fit[logs]'") from None

_Numbers = tuple[float, ...]
_Samples = Callable[[Any, PoseMap], Iterable[tuple[Any, _Numbers]]]
"""Function of a message and of what the map says of poses."""


def read_bag(path: Path, asked: LogMap) -> RawLog:
    """Read topics of a bag; times count from its beginning, since a double resolves dates to 0.2 µs only.

    Raises:
        RequestError: The bag cannot be read, lacks a topic, or has another type of messages there.
    """
    streams, labels = {}, {}
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            for name, topic in asked.sources.items():
                streams[name] = _stream(path, reader, name, topic, asked)
            for name, topic in asked.labels.items():
                labels[name] = _labels(path, reader, topic, asked)
    except AnyReaderError as error:
        raise RequestError(f"{path} cannot be read: {_line(error)}") from None
    except RequestError:
        raise
    except Exception as error:  # a bag that was cut off raises whatever its parser meets
        raise RequestError(f"{path} is damaged: {type(error).__name__}: {_line(error)}") from None
    return RawLog(path.name, streams, labels, quaternions_xyzw=True)


def _stream(path: Path, reader: AnyReader, name: str, topic: Any, asked: LogMap) -> Stream:
    if not isinstance(topic, str):
        raise RequestError(f"map: {name}.source: {shown(topic)} is invalid: expected a topic")
    found = list(_messages(path, reader, name, topic, asked))
    frame = asked.pose.frame if name == "pose" else None
    joints = asked.pose.joints if name == "pose" else None
    if not found:
        about = f" about {frame}" if frame else f" of {', '.join(joints)}" if joints else ""
        raise RequestError(f"{path}: {topic} has no message{about}")
    if len({len(values) for _, values in found}) > 1:
        raise RequestError(
            f"{path}: {topic}: its messages have different numbers of values: name the joints in pose.joints"
        )
    time, values = zip(*found, strict=True)
    return Stream(np.array(time, float), np.array(values, float))


def _labels(path: Path, reader: AnyReader, topic: str, asked: LogMap) -> Labels:
    found = list(_messages(path, reader, "labels", topic, asked))
    return Labels(np.array([time for time, _ in found], float), np.array([value[0] for _, value in found]))


def _messages(
    path: Path, reader: AnyReader, name: str, topic: str, asked: LogMap
) -> Iterable[tuple[float, _Numbers]]:
    """Return times, s, and values of a topic's messages."""
    connections = [one for one in reader.connections if one.topic == topic]
    if not connections:
        topics = ", ".join(sorted({one.topic for one in reader.connections})) or "no topics"
        raise RequestError(f"{path}: the topic {shown(topic)} is missing: it has {shortened(topics, 300)}")
    for connection in connections:
        if connection.msgtype not in _READERS[name]:
            raise RequestError(
                f"{path}: {topic}: {connection.msgtype} is invalid: expected {', '.join(_READERS[name])}"
            )
        if name == "pose" and (connection.msgtype == _JOINT_STATE) != (asked.pose.rotation == "joints"):
            raise RequestError(
                f"map: pose.rotation: {asked.pose.rotation} cannot be used with {connection.msgtype} of "
                f"{topic}: expected joints for joint states, and for nothing else"
            )
    for connection, received_ns, data in reader.messages(connections):
        message = reader.deserialize(data, connection.msgtype)
        for stamp, values in _READERS[name][connection.msgtype](message, asked.pose):
            at = received_ns if stamp is None or asked.time.stamps == "received" else _nanoseconds(stamp)
            yield SECONDS["ns"] * (at - reader.start_time), values


def _nanoseconds(stamp: Any) -> int:
    return stamp.sec * 10**9 + stamp.nanosec


def _line(error: Exception) -> str:
    return shortened(" ".join(str(error).split()), 200)


def _xyz(vector: Any) -> _Numbers:
    return vector.x, vector.y, vector.z


def _wrench(wrench: Any) -> _Numbers:
    return *_xyz(wrench.force), *_xyz(wrench.torque)


def _twist(twist: Any) -> _Numbers:
    return *_xyz(twist.linear), *_xyz(twist.angular)


def _pose(position: Any, turn: Any) -> _Numbers:
    return *_xyz(position), turn.x, turn.y, turn.z, turn.w


def _joints(message: Any, said: PoseMap) -> Iterable[tuple[Any, _Numbers]]:
    if said.joints is None:
        yield message.header.stamp, tuple(message.position)
        return
    at = dict(zip(message.name, message.position, strict=False))
    missing = [name for name in said.joints if name not in at]
    if not missing:
        yield message.header.stamp, tuple(at[name] for name in said.joints)
    elif len(missing) < len(said.joints):  # others publish messages of other joints
        raise RequestError(
            f"map: pose.joints: {shown(missing[0])} is not among {shortened(', '.join(at), 300)}"
        )


def _transform(one: Any, said: PoseMap) -> Iterable[tuple[Any, _Numbers]]:
    if said.frame is None or one.child_frame_id == said.frame:
        moved = one.transform
        yield one.header.stamp, _pose(moved.translation, moved.rotation)


def _transforms(message: Any, said: PoseMap) -> Iterable[tuple[Any, _Numbers]]:
    for one in message.transforms:
        yield from _transform(one, said)


_G, _JOINT_STATE = "geometry_msgs/msg/", "sensor_msgs/msg/JointState"
_PLACES: dict[str, _Samples] = {
    f"{_G}PointStamped": lambda said, _: [(said.header.stamp, _xyz(said.point)[:2])],
    "std_msgs/msg/Float64MultiArray": lambda said, _: [(None, tuple(said.data))],
}

_READERS: dict[str, dict[str, _Samples]] = {
    "wrench": {
        f"{_G}WrenchStamped": lambda said, _: [(said.header.stamp, _wrench(said.wrench))],
        f"{_G}Wrench": lambda said, _: [(None, _wrench(said))],
    },
    "pose": {
        f"{_G}PoseStamped": lambda said, _: [
            (said.header.stamp, _pose(said.pose.position, said.pose.orientation))
        ],
        f"{_G}Pose": lambda said, _: [(None, _pose(said.position, said.orientation))],
        f"{_G}TransformStamped": _transform,
        "tf2_msgs/msg/TFMessage": _transforms,
        _JOINT_STATE: _joints,
    },
    "command": {
        f"{_G}Vector3Stamped": lambda said, _: [(said.header.stamp, _xyz(said.vector))],
        f"{_G}PointStamped": lambda said, _: [(said.header.stamp, _xyz(said.point))],
        f"{_G}TwistStamped": lambda said, _: [(said.header.stamp, _xyz(said.twist.linear))],
    },
    "twist": {
        f"{_G}TwistStamped": lambda said, _: [(said.header.stamp, _twist(said.twist))],
        f"{_G}Twist": lambda said, _: [(None, _twist(said))],
    },
    "estimate": _PLACES,
    "place": _PLACES,
    "labels": {
        "std_msgs/msg/Bool": lambda said, _: [(None, (said.data,))],
        "std_msgs/msg/Int32": lambda said, _: [(None, (said.data,))],
        "std_msgs/msg/Int64": lambda said, _: [(None, (said.data,))],
        "std_msgs/msg/String": lambda said, _: [(None, (said.data,))],
    },
}
"""Samples of messages, their stamps first; None: the time at which the message was received."""
