"""Files of imported parts: YAML with ``scene.shapes``, to which further parts are added."""

import re
from pathlib import Path
from typing import Any

import yaml

from mjx_fit.config import strict_yaml
from mjx_fit.config.files import read_config
from mjx_fit.config.sections.shape import LONGEST_NAME, NAME
from mjx_fit.utils.errors import RequestError, shown


def with_part(path: Path, shape: dict[str, Any]) -> dict[str, Any]:
    """Return the tree of a file with one more part; a file that does not exist yet has none.

    Args:
        path: File that ``as_yaml`` made, or none.
        shape: Entry of ``scene.shapes``.

    Raises:
        RequestError: The file has a part of that name, or it was not made by ``as_yaml``: comments and order
            would be lost.
    """
    if not path.exists():
        return {"scene": {"shapes": [shape]}}
    names = read_config([path]).scene.names
    if shape["name"] in names:
        raise RequestError(
            f"--name: {shown(shape['name'])} is invalid: {path} has a part of that name; choose another"
        )
    text = path.read_text()
    tree = yaml.safe_load(text)
    if as_yaml(tree) != text or list(tree) != ["scene"] or list(tree["scene"]) != ["shapes"]:
        raise RequestError(
            f"--out: {path} cannot be used: expected a file that has nothing but parts as part import "
            "writes them; import into a new file and copy the part"
        )
    return {"scene": {"shapes": [*tree["scene"]["shapes"], shape]}}


def as_yaml(tree: dict[str, Any]) -> str:
    """Return the text of a file of parts.

    Raises:
        RequestError: The text would be too large to be read again.
    """
    text = yaml.safe_dump(tree, sort_keys=False)
    try:
        strict_yaml.load(text)
    except strict_yaml.StrictYamlError as error:
        raise RequestError(
            f"--out: the file would be too large to be read ({error}): import into another file, or choose a "
            "larger --tolerance"
        ) from None
    return text


def require_yaml(path: Path) -> None:
    """Check that a file is YAML by its name.

    Raises:
        RequestError: It is not.
    """
    if path.suffix not in (".yaml", ".yml"):
        raise RequestError(f"--out: {path} is invalid: expected a file that ends in .yaml")


def require_name(name: str) -> None:
    """Check the name of a part.

    Raises:
        RequestError: It does not start with a letter, or has other characters than letters and digits.
    """
    if not re.fullmatch(NAME, name) or len(name) > LONGEST_NAME:
        raise RequestError(
            f"--name: {shown(name)} is invalid: expected up to {LONGEST_NAME} of a-z, 0-9 and _, a letter "
            "first"
        )
