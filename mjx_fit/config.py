"""The whole configuration; strict YAML in and out.

An unknown key, a wrong type or a value out of range raises ``RequestError``. Units are in the names.
"""

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from pydantic import TypeAdapter, ValidationError, model_validator
from pydantic.dataclasses import dataclass

from mjx_fit import limits, schema_errors, strict_yaml
from mjx_fit.errors import RequestError, shortened, shown
from mjx_fit.settings import (
    FIRST_SENSOR,
    FIRST_TRAIN,
    STRICT,
    ControlConfig,
    DetectorConfig,
    RandomConfig,
    SceneConfig,
    SensorConfig,
    SequenceConfig,
    SpiralConfig,
    TaskConfig,
    TrainConfig,
    WristConfig,
)


@dataclass(frozen=True, config=STRICT)
class Config:
    """The whole configuration: sections of numbers, each checked against its range.

    Example:
        >>> import mjx_fit as mf
        >>> mf.Config().scene.clearance_m
        0.001
    """

    scene: SceneConfig = SceneConfig()
    control: ControlConfig = ControlConfig()
    spiral: SpiralConfig = SpiralConfig()
    random: RandomConfig = RandomConfig()
    detector: DetectorConfig = DetectorConfig()
    sequence: SequenceConfig = SequenceConfig()
    wrist: WristConfig = WristConfig()
    task: TaskConfig = TaskConfig()
    sensor: SensorConfig = SensorConfig()
    train: TrainConfig = TrainConfig()

    @model_validator(mode="after")
    def _rates_of_these_shapes(self) -> "Config":
        """Fills in rates that were not given; each shape must have its own."""
        task = self.task.for_shapes(self.scene.shapes)
        for name in ("success_probability", "success_by_error"):
            limits.require_one_for_each_shape(f"task.{name}", getattr(task, name), self.scene)
        object.__setattr__(self, "task", task)
        return self


def load(path: Path | Sequence[Path] | None = None, overrides: Sequence[str] = ()) -> Config:
    """The configuration of a run.

    Args:
        path: YAML file with the values that differ from the defaults, several of which later ones win over
            earlier ones key by key, or None.
        overrides: ``section.key=value`` strings, applied after the file.

    Raises:
        RequestError: The file cannot be read, or a key or value is not allowed.
    """
    tree: dict[str, Any] = {}
    paths = [] if path is None else [path] if isinstance(path, Path) else path
    for one in paths:
        for name, section in _read(one).items():
            both = isinstance(section, dict) and isinstance(tree.get(name), dict)
            tree[name] = tree[name] | section if both else section
    for override in overrides:
        _set(tree, override)
    return from_tree(tree)


def load_stored(path: Path) -> Config:
    """The configuration that a run was stored with.

    Args:
        path: Its YAML file.

    Raises:
        RequestError: The file cannot be read, or a key or value is not allowed.
    """
    return from_stored(_read(path))


def from_stored(tree: dict[str, Any]) -> Config:
    """The configuration in a stored file; keys that are younger than it mean what went without saying then.

    Raises:
        RequestError: A key or value is not allowed.
    """
    then = {"sensor": FIRST_SENSOR, "train": FIRST_TRAIN}
    filled = {
        name: dataclasses.asdict(section) | tree[name]
        for name, section in then.items()
        if isinstance(tree.get(name), dict)
    }
    return from_tree(tree | filled)


def from_tree(tree: dict[str, Any]) -> Config:
    """The configuration that differs from the defaults in the values of a nested dict.

    Raises:
        RequestError: A key or value is not allowed.
    """
    try:
        # JSON, so that lists may stand for tuples; what it cannot say becomes text, which no field takes.
        text = json.dumps(tree, default=shown)
        config = TypeAdapter(Config).validate_json(text)
    except ValidationError as error:
        raise RequestError(f"config: {schema_errors.in_words(error, Config)}") from None
    except (RecursionError, TypeError, ValueError):  # nested without end, or keys that are no names
        raise RequestError(
            f"config: {shown(tree)} is not allowed: it must hold sections of names and values"
        ) from None
    limits.require_steady(config.scene, config.control, config.spiral, config.random, config.task)
    require_room(config, "spiral.radius_m", config.spiral.radius_m)
    return config


def require_room(config: Config, key: str, radius_m: float) -> None:
    """Make sure that a peg stays over its plate, wherever the detector and the policy may bring it.

    Args:
        config: The configuration.
        key: What says how far the policy goes from the estimate.
        radius_m: How far that is.

    Raises:
        RequestError: The plate is too small.
    """
    detector, scene = config.detector, config.scene
    error = detector.half_width_m * (math.sqrt(2) if detector.kind == "square" else 1)
    reach = error + radius_m + max(shape.half_width_m for shape in scene.shapes)
    if reach > scene.plate_half_width_m:
        raise RequestError(
            f"config: scene.plate_half_width_m: {scene.plate_half_width_m} is not allowed: it must be at "
            f"least {math.ceil(1000 * reach) / 1000}: the detector's error, {key} and half a peg"
        )


def to_tree(config: Config) -> dict[str, Any]:
    """The whole configuration as nested dicts and lists, ready for YAML or JSON."""
    return json.loads(json.dumps(dataclasses.asdict(config)))


def to_yaml(config: Config) -> str:
    """The whole configuration as YAML; ``load`` reads it back unchanged."""
    return yaml.safe_dump(to_tree(config), sort_keys=False)


def from_yaml(text: str) -> Config:
    """What ``to_yaml`` wrote.

    Raises:
        RequestError: It is something else.
    """
    try:
        tree = strict_yaml.load(text)
    except strict_yaml.StrictYamlError as error:
        raise RequestError(f"config: {error}") from None
    return from_tree(tree)


def differences(one: Config, other: Config) -> list[str]:
    """The keys in which two configurations differ, in words: ``section.key is 1 there and 2 here``."""
    there, here = to_tree(one), to_tree(other)
    return [
        f"{section}.{key} is {value} there and {here[section][key]} here"
        for section, values in there.items()
        for key, value in values.items()
        if value != here[section][key]
    ]


def _read(path: Path) -> dict[str, Any]:
    name = str(path) if str(path).isprintable() else shown(str(path))
    try:
        with Path(path).open("rb") as file:
            content = file.read(strict_yaml.MOST_BYTES + 1)
        loaded = strict_yaml.load(_decoded(content))
    except OSError as error:
        raise RequestError(f"config: {shortened(name, 300)} cannot be read: {error.strerror}") from None
    except strict_yaml.StrictYamlError as error:
        raise RequestError(f"config: {shortened(name, 300)} cannot be read: {error}") from None
    except ValueError:
        raise RequestError(f"config: {name} cannot be read: a path holds no NUL") from None
    if not isinstance(loaded, dict | None):
        raise RequestError(
            f"config: {name} must hold sections such as 'scene:', not a {type(loaded).__name__}"
        )
    return loaded or {}


def _decoded(content: bytes) -> str:
    """UTF-8 text, whatever the locale."""
    if len(content) > strict_yaml.MOST_BYTES:
        raise strict_yaml.StrictYamlError(
            f"it has more than the {strict_yaml.MOST_BYTES} bytes that are allowed"
        )
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise strict_yaml.StrictYamlError(
            f"byte {error.start} (0x{content[error.start]:02x}) is not allowed: it must be UTF-8 text"
        ) from None


def _set(tree: dict[str, Any], override: str) -> None:
    path, separator, text = override.partition("=")
    keys = path.strip().split(".")
    if not separator or len(keys) != 2 or not all(keys):
        raise RequestError(
            f"--set: {shown(override)} is not allowed: write section.key=value, e.g. scene.clearance_m=0.002"
        )
    section = tree.setdefault(keys[0], {})
    if not isinstance(section, dict):
        raise RequestError(f"config: {keys[0]}: {shown(section)} is not allowed: it must be a section")
    try:
        section[keys[1]] = strict_yaml.load(text)
    except strict_yaml.StrictYamlError as error:
        raise RequestError(f"--set: {shown(override)} is not allowed: it is no YAML value: {error}") from None
