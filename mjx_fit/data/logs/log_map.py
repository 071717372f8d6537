"""Map of a log: where its signals are, and in which units, frames and signs (a YAML file).

Nothing of this is guessed: what a log does not say about itself, the map says.
"""

import json
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from mjx_fit.config import schema_errors
from mjx_fit.config.files import read_tree
from mjx_fit.config.sections.fields import STRICT
from mjx_fit.data.logs.attempts_map import AttemptsMap, Metres, Name, Source, TruthMap
from mjx_fit.utils.errors import RequestError, shown

_Degrees = Annotated[float, Field(ge=-360, le=360)]


@dataclass(frozen=True, config=STRICT)
class FrameMap:
    """Pose of a frame in another one: its origin, and turns about x, then y, then z of the other frame."""

    position_m: tuple[Metres, Metres, Metres] = (0.0, 0.0, 0.0)
    rpy_deg: tuple[_Degrees, _Degrees, _Degrees] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, config=STRICT)
class WrenchMap:
    """Force and torque.

    Attributes:
        source: Topic (``WrenchStamped``, ``Wrench``), array (N, 6), or six columns: forces, then torques.
        acts_on: What the wrench acts on: ``peg`` (what the arm exerts on the peg, the library's sign:
            pressing down is positive along the tool) or ``arm`` (the reaction, as most drivers publish it).
        force: Unit of forces.
        torque: Unit of torques.
        axes: Frame that the wrench is expressed in: ``sensor``, or the robot's ``base``.
        sensor_in_tool: The sensor's frame in that of the tool, whose origin is the TCP and whose z points
            away from the arm: a sensor 0.1 m above the peg's lower face is at [0, 0, -0.1]. Torques are about
            its origin, wherever its axes point.
        most_n: Range of the sensor, N: values beyond it are saturated.
    """

    source: Source
    acts_on: Literal["peg", "arm"]
    sensor_in_tool: FrameMap
    force: Literal["N", "lbf"] = "N"
    torque: Literal["N m", "N mm", "lbf in"] = "N m"
    axes: Literal["sensor", "base"] = "sensor"
    most_n: Annotated[float, Field(ge=1, le=100_000)] = 300.0


@dataclass(frozen=True, config=STRICT)
class PoseMap:
    """Pose of the tool.

    Attributes:
        source: Topic (``PoseStamped``, ``Pose``, ``TransformStamped``, ``tf2_msgs/TFMessage``,
            ``JointState``), array (M, 7) or (M, 6), or columns: position, then rotation; or the angles of
            the joints.
        rotation: How the rotation is written. Topics have quaternions, except for ``joints``: then the source
            has the angles of the robot's joints, and its kinematics give the pose of the TCP in the
            library's world.
        joints: Names of the joints in a topic, from the base on; None: in the order of the messages. Arrays
            and features have the order of the joints.
        length: Unit of positions.
        angle: Unit of the angles of ``rotvec``, ``rpy`` and ``joints``.
        frame: Child frame to take from a topic of transforms.
        tool_in_pose: The frame of the tool in that of the logged pose. The tool's origin is the TCP, the
            centre of the peg's lower face; its z points along the peg, out of the hand.
        base_in_world: The frame that poses are in, in the library's world: that of the robot's base, but with
            z = 0 on the table. A base 0.2 m below the table top is at [0, 0, -0.2].
    """

    source: Source
    rotation: Literal["quat_xyzw", "quat_wxyz", "rotvec", "rpy", "joints"] = "quat_xyzw"
    joints: tuple[Name, ...] | None = None
    length: Literal["m", "mm"] = "m"
    angle: Literal["rad", "deg"] = "rad"
    frame: Name | None = None
    tool_in_pose: FrameMap = FrameMap()
    base_in_world: FrameMap = FrameMap()

    def __post_init__(self) -> None:
        if self.rotation != "joints":
            if self.joints is not None:
                raise ValueError("joints: it has no effect without rotation: joints")
        elif self.length != "m" or self.frame is not None:
            raise ValueError("rotation: joints cannot be used with length or frame, which have no effect")
        elif self.joints is not None and not isinstance(self.source, str):
            raise ValueError("joints: it cannot be used with columns, whose order is that of the joints")


@dataclass(frozen=True, config=STRICT)
class TwistMap:
    """Velocity of the tool's TCP, linear, then angular.

    Attributes:
        source: Topic (``TwistStamped``, ``Twist``), array (M, 6), or six columns.
        axes: Frame that it is expressed in: the robot's ``base``, or the ``tool``.
        length: Unit of lengths.
        angle: Unit of angles.
    """

    source: Source
    axes: Literal["base", "tool"] = "base"
    length: Literal["m", "mm"] = "m"
    angle: Literal["rad", "deg"] = "rad"


@dataclass(frozen=True, config=STRICT)
class CommandMap:
    """Commands of the policy, 10 a second.

    Attributes:
        source: Topic (``Vector3Stamped``, ``PointStamped``, ``TwistStamped``), array (J, 3), or columns.
        kind: ``displacement`` of the TCP in an action, or the ``target`` it is to be at; in the axes of the
            robot's base.
        length: Unit.
    """

    source: Source
    kind: Literal["displacement", "target"] = "displacement"
    length: Literal["m", "mm"] = "m"


@dataclass(frozen=True, config=STRICT)
class LoadMap:
    """What hangs on the sensor: tool and peg.

    Its weight is taken out of the wrench, as the tool turns. Without it the weight is a part of the tare, and
    a tool that tilts by 0.1 rad with 1 kg changes the wrench by 1 N.

    Attributes:
        mass_kg: Mass.
        centre_m: Centre of mass in the sensor's frame, m.
    """

    mass_kg: Annotated[float, Field(ge=0, le=50)]
    centre_m: tuple[Metres, Metres, Metres] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, config=STRICT)
class TimeMap:
    """Times of samples.

    Attributes:
        source: Column or array of times; that of a signal is ``SIGNAL_time`` if it exists. Bags have stamps.
        unit: Unit.
        stamps: Of bags: those of the messages' headers, or when they were received.
    """

    source: Name = "time"
    unit: Literal["s", "ms", "us", "ns"] = "s"
    stamps: Literal["header", "received"] = "header"


@dataclass(frozen=True, config=STRICT)
class LogMap:
    """The whole map.

    Attributes:
        wrench: Force and torque.
        pose: Pose of the tool.
        command: Commands; None: the displacement of the TCP in each action.
        twist: Velocity of the TCP; None: it is differentiated from the poses.
        load: What hangs on the sensor; None: nothing that is known.
        time: Times of samples.
        attempts: Where attempts are.
        truth: What is known about them afterwards; None: nothing.
    """

    wrench: WrenchMap
    pose: PoseMap
    command: CommandMap | None = None
    twist: TwistMap | None = None
    load: LoadMap | None = None
    time: TimeMap = TimeMap()
    attempts: AttemptsMap = AttemptsMap()
    truth: TruthMap | None = None

    @property
    def sources(self) -> dict[str, Source]:
        """Where each signal is, by its name."""
        found: dict[str, Source] = {"wrench": self.wrench.source, "pose": self.pose.source}
        for name, own in (("command", self.command), ("twist", self.twist)):
            if own is not None:
                found[name] = own.source
        if self.attempts.estimate_source is not None:
            found["estimate"] = self.attempts.estimate_source
        if self.truth is not None and self.truth.place_source is not None:
            found["place"] = self.truth.place_source
        return found

    @property
    def labels(self) -> dict[str, Name]:
        """Where labels are: of ``attempts``, of types (``pegs``, ``holes``), of outcomes (``inserted``)."""
        own = {"attempts": self.attempts.source, "pegs": self.attempts.peg_source}
        if self.truth is not None:
            own |= {"holes": self.truth.hole_source, "inserted": self.truth.inserted_source}
        return {name: source for name, source in own.items() if source is not None}


def read_map(path: Path | str) -> LogMap:
    """Read a map.

    Raises:
        RequestError: The file cannot be read, or a key or value is invalid.
    """
    tree = read_tree(Path(path), "map", "wrench")
    try:
        return TypeAdapter(LogMap).validate_json(json.dumps(tree, default=shown))
    except ValidationError as error:
        raise RequestError(f"{path}: {schema_errors.in_words(error, LogMap)}") from None
