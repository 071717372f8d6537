"""Presets of parts under a name, in configs/parts."""

from pathlib import Path

from mjx_fit.config.files import read_tree
from mjx_fit.utils import resources
from mjx_fit.utils.errors import RequestError, shown

PART_SETS = ("paper", "nist", "shafts", "nonconvex")
"""Names of the presets; the first is the default of ``scene.shapes``."""


def parts_file(name: str | None) -> list[Path]:
    """Return the file of a preset, or the file of that name, as a list that is empty for the default parts.

    Args:
        name: Name of a preset, or path of a YAML file with parts; None: the default.

    Raises:
        RequestError: There is no such preset or file, or the file has no parts.
    """
    if name is None or name == PART_SETS[0]:
        return []
    if name in PART_SETS:
        return [resources.folder("configs") / "parts" / f"{name}.yaml"]
    if Path(name).suffix not in (".yaml", ".yml"):
        raise RequestError(
            f"--parts: {shown(name)} is invalid: expected {', '.join(PART_SETS)} or a YAML file"
        )
    scene = read_tree(Path(name)).get("scene")
    if isinstance(scene, dict | None) and "shapes" not in (scene or {}):
        raise RequestError(f"--parts: {name} cannot be used: it has no scene.shapes")
    return [Path(name)]
