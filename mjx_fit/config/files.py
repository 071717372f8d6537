"""Configurations from files and ``--set``: strict YAML; unknown keys and invalid values are rejected."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mjx_fit.config import strict_yaml
from mjx_fit.config.schema import Config, config_from_stored, config_from_tree
from mjx_fit.utils.errors import RequestError, shortened, shown


def read_config(path: Path | Sequence[Path] | None = None, overrides: Sequence[str] = ()) -> Config:
    """Read the configuration of a run.

    Args:
        path: YAML file with the values that differ from the defaults, or several files, where later ones take
            precedence key by key; None: no file.
        overrides: Strings ``section.key=value``, applied after the files.

    Raises:
        RequestError: The file cannot be read, or a key or value is invalid.
    """
    paths = [] if path is None else [path] if isinstance(path, Path) else path
    return config_from_tree(config_tree(paths, overrides))


def config_tree(paths: Sequence[Path], overrides: Sequence[str] = ()) -> dict[str, Any]:
    """Return the sections of files and overrides (``read_config``), whose keys and values are not checked.

    Raises:
        RequestError: A file cannot be read, or an override has another form.
    """
    tree: dict[str, Any] = {}
    for one in paths:
        for name, section in read_tree(one).items():
            both = isinstance(section, dict) and isinstance(tree.get(name), dict)
            tree[name] = tree[name] | section if both else section
    for override in overrides:
        _set(tree, override)
    return tree


def read_stored_config(path: Path) -> Config:
    """Read the stored configuration of a run.

    Args:
        path: YAML file stored with the run.

    Raises:
        RequestError: The file cannot be read, or a key or value is invalid.
    """
    return config_from_stored(read_tree(path))


def read_tree(path: Path, what: str = "config", section: str = "scene") -> dict[str, Any]:
    """Read the sections of a YAML file, which are not checked.

    Args:
        path: The file.
        what: Word for it in messages.
        section: Name of a section, for messages.

    Raises:
        RequestError: The file cannot be read.
    """
    name = str(path) if str(path).isprintable() else shown(str(path))
    try:
        with Path(path).open("rb") as file:
            content = file.read(strict_yaml.MOST_BYTES + 1)
        loaded = strict_yaml.load(_decoded(content))
    except OSError as error:
        raise RequestError(f"{what}: {shortened(name, 300)} cannot be read: {error.strerror}") from None
    except strict_yaml.StrictYamlError as error:
        raise RequestError(f"{what}: {shortened(name, 300)} cannot be read: {error}") from None
    except ValueError:
        raise RequestError(f"{what}: {name} cannot be read: a path must not contain NUL") from None
    if not isinstance(loaded, dict | None):
        raise RequestError(
            f"{what}: {name}: a {type(loaded).__name__} is invalid: expected sections such as '{section}:'"
        )
    return loaded or {}


def _decoded(content: bytes) -> str:
    """Decode UTF-8 text, independent of the locale."""
    if len(content) > strict_yaml.MOST_BYTES:
        raise strict_yaml.StrictYamlError(f"it is too large: expected at most {strict_yaml.MOST_BYTES} bytes")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise strict_yaml.StrictYamlError(
            f"byte {error.start} (0x{content[error.start]:02x}) is invalid: expected UTF-8 text"
        ) from None


def _set(tree: dict[str, Any], override: str) -> None:
    path, separator, text = override.partition("=")
    keys = path.strip().split(".")
    if not separator or len(keys) != 2 or not all(keys):
        raise RequestError(
            f"--set: {shown(override)} is invalid: expected section.key=value, e.g. scene.clearance_m=0.002"
        )
    section = tree.setdefault(keys[0], {})
    if not isinstance(section, dict):
        raise RequestError(f"config: {keys[0]}: {shown(section)} is invalid: expected a section")
    try:
        section[keys[1]] = strict_yaml.load(text)
    except strict_yaml.StrictYamlError as error:
        raise RequestError(f"--set: {shown(override)} is invalid: expected a YAML value: {error}") from None
