"""Fields of a shard: the name, unit, frame, shape and meaning of each."""

from typing import Any, NamedTuple

from mjx_fit.config.quantities import QUANTITIES
from mjx_fit.config.randomized import distributions
from mjx_fit.config.schema import Config
from mjx_fit.data.manifest import ROBOT
from mjx_fit.scene.placement import GRASP


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

_LABELS = ("inserted", "hole_type", "hole_pos_world")
"""Fields that a robot's user may know."""
_SIMULATED = ("end_qpos", "end_qvel", "valid")
"""Fields that only a simulator knows."""

START = "start/"
_START = {
    f"{START}pos_world": Field("m", "world", "n 3", "the tip at rest, before the first action"),
    f"{START}quat_world": Field("1", "world", "n 4", "its orientation, w x y z"),
}

PHYSICS = "physics/"
"""Group of the quantities that each world drew for itself; only those with a distribution are stored."""


class Kind(NamedTuple):
    """What decides which fields a data set has, beside its configuration.

    Attributes:
        turns: Whether commands turn the TCP.
        robot: Whether a robot made it: then the start of attempts is measured.
        labelled: Whether somebody says of a robot's attempts which hole it was, and whether the peg went in.
    """

    turns: bool = False
    robot: bool = False
    labelled: bool = False

    @property
    def unknown(self) -> tuple[str, ...]:
        """Fields of the truth that nobody knows."""
        if not self.robot:
            return ()
        return _SIMULATED if self.labelled else (*_LABELS, *_SIMULATED)


def kind_of(request: dict[str, Any]) -> Kind:
    """Return the kind of the data set of a request."""
    return Kind(request.get("turns", False), request["engine"] == ROBOT, request.get("labelled", False))


def fields_of(config: Config, kind: Kind) -> dict[str, Field]:
    """Return the fields of a data set: those of every data set, and the physics that its worlds drew.

    Args:
        config: The configuration; ``filter.coordinates`` gives estimates their axes.
        kind: What else decides.
    """
    fields, d = dict(FIELDS), len(config.filter.coordinates)
    if kind.turns:
        fields |= _TURNS
    if d > 2:
        named = f"as filter.coordinates: {', '.join(config.filter.coordinates)}"
        for name, shape, unit in (
            ("estimate_world", f"n {d}", "m, rad"),
            ("estimate_cov", f"n {d} {d}", "m², rad²"),
        ):
            meaning = f"{FIELDS[name].meaning}, {named}"
            fields[name] = FIELDS[name]._replace(shape=shape, unit=unit, meaning=meaning)
    if kind.robot:
        return {name: field for name, field in fields.items() if name not in kind.unknown} | _START
    own = {name: f"drawn from randomize.{name}" for name in distributions(config.randomize)}
    if config.placement.slips:
        own |= dict.fromkeys(GRASP, "the grasp at the end of the attempt")
    units = {name: QUANTITIES[name].unit for name in own}
    own = {f"{PHYSICS}{name}": Field(units[name], "-", "n", meaning) for name, meaning in own.items()}
    return fields | own
