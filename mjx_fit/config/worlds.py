"""Presets of the world: physics and measurements under a name, in configs/worlds."""

from pathlib import Path

from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config
from mjx_fit.utils import resources
from mjx_fit.utils.errors import RequestError, shown

WORLDS = ("home", "as-2026-11", "paper", "forge", "wide", "bench")
"""Names of the presets; the first is the default of every key."""


def world_file(name: str | None) -> list[Path]:
    """Return the file of a preset, as a list that is empty for the default world.

    Args:
        name: Name of the preset; None: the default.

    Raises:
        RequestError: There is no such preset.
    """
    if name is None or name == WORLDS[0]:
        return []
    if name not in WORLDS:
        raise RequestError(f"--world: {shown(name)} is invalid: expected {', '.join(WORLDS)}")
    return [resources.folder("configs") / "worlds" / f"{name}.yaml"]


def preset(name: str, world: str | None = None) -> Config:
    """Read a preset of the folder ``configs`` on top of a world.

    Args:
        name: Name of the preset, such as ``gentle``.
        world: Name of the world; None: the default.

    Raises:
        RequestError: There is no such preset or world.
    """
    return read_config([*world_file(world), resources.folder("configs") / f"{name}.yaml"])
