"""Complete configuration: sections, rules, and conversion to and from trees and YAML."""

import dataclasses
import json
import math
from collections.abc import Callable
from typing import Any

import yaml
from pydantic import TypeAdapter, ValidationError, model_validator
from pydantic.dataclasses import dataclass

from mjx_fit.config import cross_section_rules, randomized, schema_errors, strict_yaml
from mjx_fit.config.sections.fields import STRICT
from mjx_fit.config.sections.filter import FilterConfig
from mjx_fit.config.sections.first import FIRST_VALUES
from mjx_fit.config.sections.learning import SensorConfig, TrainConfig
from mjx_fit.config.sections.measurement import PoseConfig, WristConfig
from mjx_fit.config.sections.moves import MovesConfig
from mjx_fit.config.sections.particles import ParticlesConfig
from mjx_fit.config.sections.placement import PlacementConfig
from mjx_fit.config.sections.randomize import RandomizeConfig
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.config.sections.seek import SeekConfig
from mjx_fit.config.sections.shape import Shape
from mjx_fit.config.sections.task import TaskConfig
from mjx_fit.config.sections.world import (
    ArmConfig,
    ControlConfig,
    DetectorConfig,
    RandomConfig,
    SequenceConfig,
    SpiralConfig,
)
from mjx_fit.utils.errors import RequestError, shown


@dataclass(frozen=True, config=STRICT)
class Config:
    """Complete configuration: sections of values, each checked against its range.

    Example:
        >>> import mjx_fit as mf
        >>> mf.Config().scene.clearance_m
        0.001
    """

    scene: SceneConfig = SceneConfig()
    control: ControlConfig = ControlConfig()
    arm: ArmConfig = ArmConfig()
    placement: PlacementConfig = PlacementConfig()
    randomize: RandomizeConfig = RandomizeConfig()
    spiral: SpiralConfig = SpiralConfig()
    random: RandomConfig = RandomConfig()
    seek: SeekConfig = SeekConfig()
    detector: DetectorConfig = DetectorConfig()
    sequence: SequenceConfig = SequenceConfig()
    wrist: WristConfig = WristConfig()
    pose: PoseConfig = PoseConfig()
    task: TaskConfig = TaskConfig()
    moves: MovesConfig = MovesConfig()
    filter: FilterConfig = FilterConfig()
    particles: ParticlesConfig = ParticlesConfig()
    sensor: SensorConfig = SensorConfig()
    train: TrainConfig = TrainConfig()

    @model_validator(mode="after")
    def _rates_of_these_shapes(self) -> "Config":
        """Fill in missing rates; each shape must have its own."""
        task = self.task.for_shapes(self.scene.shapes)
        for name in ("success_probability", "success_by_error"):
            cross_section_rules.require_one_for_each_shape(f"task.{name}", getattr(task, name), self.scene)
        object.__setattr__(self, "task", task)
        return self


def config_from_stored(tree: dict[str, Any]) -> Config:
    """Convert a stored tree to a configuration; keys missing in older files get their original values.

    Raises:
        RequestError: A key or value is invalid.
    """
    filled = {
        name: values | tree.get(name, {})
        for name, values in FIRST_VALUES.items()
        if isinstance(tree.get(name, {}), dict)
    }
    if "rotation" in filled.get("sensor", {}):  # one version's name of sensor.pose
        filled["sensor"]["pose"] = "start" if filled["sensor"].pop("rotation") == "vector" else "world"
    return config_from_tree(tree | filled)


def config_from_tree(tree: dict[str, Any]) -> Config:
    """Convert a nested dict to a configuration; missing keys get their defaults.

    Raises:
        RequestError: A key or value is invalid.
    """
    try:
        # Validate as JSON, so that lists are accepted as tuples; other types become text, which is rejected.
        text = json.dumps(tree, default=shown)
        config = TypeAdapter(Config).validate_json(text)
    except ValidationError as error:
        raise RequestError(f"config: {schema_errors.in_words(error, Config)}") from None
    except (RecursionError, TypeError, ValueError):  # nested too deeply, or keys that are not strings
        raise RequestError(
            f"config: {shown(tree)} is invalid: expected sections of names and values"
        ) from None
    randomized.require_valid(config)
    randomized.require_clear_start(config)
    for corner in randomized.extremes(config):
        cross_section_rules.require_steady(
            corner.scene, corner.control, corner.spiral, corner.random, corner.task
        )
    require_room(config, "spiral.radius_m", config.spiral.radius_m)
    return config


def require_room(config: Config, key: str, radius_m: float) -> None:
    """Check that the peg stays above its socket for every detector error and policy goal.

    Args:
        config: Configuration of scene and detector.
        key: Key that sets the reach of the policy.
        radius_m: Largest distance of the policy's goal from the estimate, m.

    Raises:
        RequestError: The socket is too small.
    """
    detector, scene = config.detector, config.scene
    error = detector.half_width_m * (math.sqrt(2) if detector.kind == "square" else 1)
    largest = randomized.value_range(config, "part_scale")[1]
    reach = error + radius_m + largest * max(shape.half_width_m for shape in scene.shapes)
    if reach > scene.plate_half_width_m:
        raise RequestError(
            f"config: scene.plate_half_width_m: {scene.plate_half_width_m} is invalid: expected at "
            f"least {math.ceil(1000 * reach) / 1000}: the sum of detector error, {key} and half a peg"
        )


def config_to_tree(config: Config) -> dict[str, Any]:
    """Convert a configuration to nested dicts and lists, ready for YAML or JSON."""
    return json.loads(json.dumps(dataclasses.asdict(config)))


def config_to_yaml(config: Config) -> str:
    """Convert a configuration to YAML; ``read_config`` reads it back unchanged."""
    return yaml.safe_dump(config_to_tree(config), sort_keys=False)


def config_from_yaml(text: str) -> Config:
    """Parse the output of ``config_to_yaml``.

    Raises:
        RequestError: The text is no valid configuration.
    """
    try:
        tree = strict_yaml.load(text)
    except strict_yaml.StrictYamlError as error:
        raise RequestError(f"config: {error}") from None
    return config_from_tree(tree)


def in_words(value: Any) -> str:
    """Format a value of a tree; a distribution as its kind and numbers."""
    if isinstance(value, dict):
        given = {name: numbers for name, numbers in value.items() if numbers is not None}
        return ", ".join(f"{name} {numbers}" for name, numbers in given.items())
    return str(value)


def config_differences(
    one: Config, other: Config, considered: Callable[[str, str], bool] = lambda section, key: True
) -> list[str]:
    """List the keys in which two configurations differ: ``section.key is 1 there and 2 here``.

    Args:
        one: Configuration "there".
        other: Configuration "here".
        considered: Function of a section and a key; those for which it is False are left out.
    """
    there, here = config_to_tree(one), config_to_tree(other)
    return [
        difference
        for section, values in there.items()
        for key, value in values.items()
        if value != here[section][key] and considered(section, key)
        for difference in (
            shape_differences(one.scene.shapes, other.scene.shapes)
            if key == "shapes"
            else [f"{section}.{key} is {in_words(value)} there and {in_words(here[section][key])} here"]
        )
    ]


def shape_differences(one: tuple[Shape, ...], other: tuple[Shape, ...]) -> list[str]:
    """List the differences of parts: their names, or else the keys in which parts of one name differ."""
    there, here = ([shape.name for shape in shapes] for shapes in (one, other))
    if there != here:
        return [f"scene.shapes is {', '.join(there)} there and {', '.join(here)} here"]
    return [
        f"scene.shapes: {old.name}.{field.name} is {before} there and {after} here"
        if isinstance(before, float | None) and isinstance(after, float | None)
        else f"scene.shapes: {field.name} of {old.name} is another there than here"
        for old, new in zip(one, other, strict=True)
        for field in dataclasses.fields(Shape)
        if (before := getattr(old, field.name)) != (after := getattr(new, field.name))
    ]
