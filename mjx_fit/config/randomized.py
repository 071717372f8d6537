"""Checks of ``randomize``: every drawn value must be valid, alone and in combination."""

import dataclasses
from collections.abc import Iterable, Iterator
from itertools import product
from typing import TYPE_CHECKING, Any

from mjx_fit.config.quantities import MEASURED, QUANTITIES
from mjx_fit.config.schema_errors import members, plain_and_limits
from mjx_fit.config.sections.measurement import PoseConfig, WristConfig
from mjx_fit.config.sections.placement import PlacementConfig
from mjx_fit.config.sections.randomize import Distribution, RandomizeConfig
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.config.sections.world import ArmConfig, ControlConfig
from mjx_fit.utils.errors import RequestError

if TYPE_CHECKING:
    from mjx_fit.config.schema import Config

Distributions = dict[str, Distribution]

PART_SCALE = (0.8, 1.2)
"""Range of the factor of all cross-sections."""
_SCHEMAS: dict[str, Any] = {
    "scene": SceneConfig,
    "control": ControlConfig,
    "arm": ArmConfig,
    "placement": PlacementConfig,
    "wrist": WristConfig,
    "pose": PoseConfig,
}
_COMBINED = ("friction", "contact_time_s", "kp_position", "kp_orientation", "damping_ratio")
"""Quantities that rules across sections restrict in combination."""


def distributions(randomize: RandomizeConfig, names: Iterable[str] = tuple(QUANTITIES)) -> Distributions:
    """Return the distributions of quantities that are not constant, by name.

    Args:
        randomize: The section.
        names: Quantities to consider: ``QUANTITIES``, those of worlds, or ``MEASURED``.
    """
    named = {name: getattr(randomize, name) for name in names}
    return {name: one for name, one in named.items() if one is not None}


def require_valid(config: "Config") -> None:
    """Check that every value that ``randomize`` may draw is in the range of the key that it replaces.

    Raises:
        RequestError: A distribution reaches beyond the range.
    """
    for name, distribution in distributions(config.randomize, (*QUANTITIES, *MEASURED)).items():
        (low, high), (least, most) = distribution.support, allowed_range(name)
        if low < least or high > most:
            raise RequestError(
                f"config: randomize.{name}: values from {low:g} to {high:g} are invalid: expected "
                f"{least:g} to {most:g}"
            )


def require_clear_start(config: "Config") -> None:
    """Check that no peg begins an attempt in its socket.

    Raises:
        RequestError: Sockets may be so high, or pegs so low in the hand, that the start height is too small.
    """
    reach = value_range(config, "socket_z_m")[1] + value_range(config, "grasp_z_m")[1]
    if config.scene.start_height_m <= reach:
        raise RequestError(
            f"config: scene.start_height_m: {config.scene.start_height_m:g} is invalid: expected more than "
            f"{reach:g}, by which the highest socket and the lowest peg of placement approach each other"
        )


def extremes(config: "Config") -> Iterator["Config"]:
    """Yield the configuration, and those at the extremes of the quantities that rules combine."""
    yield config
    supports = {
        name: one.support for name, one in distributions(config.randomize).items() if name in _COMBINED
    }
    steps = config.scene.physics_steps  # one number for all worlds
    for values in product(*supports.values()) if supports else ():
        corner = config
        for name, value in zip(supports, values, strict=True):
            section = QUANTITIES[name].section
            own = {name: value} | ({"steps_per_torque": steps} if section == "scene" else {})
            changed = dataclasses.replace(getattr(corner, section), **own)
            corner = dataclasses.replace(corner, **{section: changed})
        yield corner


def value_range(config: "Config", name: str) -> tuple[float, float]:
    """Return the smallest and largest value that a quantity has under a configuration.

    A bandwidth that is not set counts as the highest.
    """
    distribution = getattr(config.randomize, name)
    if distribution is not None:
        return distribution.support
    section = section_of(name)
    value = getattr(getattr(config, section), name) if section else 1.0
    value = allowed_range(name)[1] if value is None else value
    return value, value


def not_covered(wide: "Config", narrow: "Config", names: Iterable[str]) -> list[str]:
    """List the quantities with values under one configuration that they never have under a wider one."""
    ranges = {name: (value_range(wide, name), value_range(narrow, name)) for name in names}
    return [name for name, ((a, b), (low, high)) in ranges.items() if low < a or high > b]


def difference(name: str, there: "Config", here: "Config") -> str:
    """Describe the values of a quantity under two configurations: ``section.key is A there and B here``."""
    values = (value_range(config, name) for config in (there, here))
    one, other = (f"{low:g}" if low == high else f"{low:g} to {high:g}" for low, high in values)
    return f"{section_of(name) or 'randomize'}.{name} is {one} there and {other} here"


def section_of(name: str) -> str:
    """Return the section that holds a quantity's constant value; empty: none does."""
    return QUANTITIES[name].section if name in QUANTITIES else MEASURED[name]


def allowed_range(name: str) -> tuple[float, float]:
    """Return the smallest and largest allowed value of a quantity."""
    section = section_of(name)
    if not section:
        return PART_SCALE
    annotation = {field.name: field.type for field in dataclasses.fields(_SCHEMAS[section])}[name]
    limits = plain_and_limits(members(annotation)[0])[1]
    return limits["ge"], limits["le"]
