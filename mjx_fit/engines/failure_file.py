"""Read the file of a diverged simulation, which may come from an untrusted bug report."""

import zipfile
from dataclasses import fields
from pathlib import Path

import numpy as np

from mjx_fit.config.quantities import QUANTITIES
from mjx_fit.config.randomized import allowed_range
from mjx_fit.config.schema import config_from_yaml
from mjx_fit.control.goals import Goal
from mjx_fit.control.policies import OWN
from mjx_fit.utils.errors import RequestError

LARGEST = 1 << 20
"""Maximum size of the file, packed or unpacked, bytes."""
MAX_HORIZON = 10**6

_FORM: dict[str, tuple[str, tuple[int, ...]]] = {
    "qpos": ("f", (7,)),
    "qvel": ("f", (7,)),
    "step": ("i", ()),
    "horizon": ("i", ()),
    "config": ("U", ()),
    "key": ("u", (2,)),
    "peg_type": ("i", ()),
    "hole_type": ("i", ()),
    "hole_pos_world": ("f", (2,)),
    "estimate_world": ("f", (2,)),
    "policy": ("i", ()),
}
"""Kind and shape of each array."""
_PHYSICS = {f"physics_{name}": ("f", ()) for name in QUANTITIES}
"""Arrays of worlds with physics of their own; any of them may be missing."""
GOALS = tuple(field.name for field in fields(Goal))
_GOALS = {f"goal_{name}": ("f", (3,)) for name in GOALS}
"""Arrays of the controller's goal; older files lack them. They have six components if the policy turns."""
_OPTIONAL = _PHYSICS | _GOALS


def read(path: Path) -> dict[str, np.ndarray]:
    """Read the arrays of the file, by name.

    Raises:
        RequestError: The file is unreadable, or differs from the format of ``failures.report``.
    """
    try:
        return _read(path)
    except OSError as error:
        raise RequestError(f"replay: {path} cannot be read: {error.strerror or error}") from None
    except Exception as error:  # archives, headers and NumPy raise many types
        what = " ".join(str(error).split())[:120]
        raise RequestError(f"replay: {path} is not the file of a diverged simulation: {what}") from None


def _read(path: Path) -> dict[str, np.ndarray]:
    if not path.is_file():
        raise FileNotFoundError(2, "there is no such file")
    if path.stat().st_size > LARGEST:
        raise ValueError(f"it has more than {LARGEST:,} bytes")
    with zipfile.ZipFile(path) as packed:
        names = [info.filename.removesuffix(".npy") for info in packed.infolist()]
        if len(set(names)) < len(names) or not set(_FORM) <= set(names) <= set(_FORM | _OPTIONAL):
            raise ValueError(f"expected only {', '.join(_FORM)}, physics and goal")
        if sum(info.file_size for info in packed.infolist()) > LARGEST:
            raise ValueError(f"it unpacks to more than {LARGEST:,} bytes")
        for name in names:
            _require_form(name, packed)
    with np.load(path, allow_pickle=False) as kept:
        arrays = {name: kept[name] for name in names}
    _require_values(arrays)
    if 0 < len(_GOALS.keys() & arrays) < len(_GOALS):
        raise ValueError(f"expected all of {', '.join(_GOALS)}, or none")
    return arrays


def _require_form(name: str, packed: zipfile.ZipFile) -> None:
    """Check the kind and shape of an array from its header, before any allocation."""
    kind, shape = (_FORM | _OPTIONAL)[name]
    with packed.open(f"{name}.npy") as file:
        version = np.lib.format.read_magic(file)
        reader = (
            np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        )
        found_shape, _, dtype = reader(file)
    shapes = (shape, (6,)) if name in _GOALS else (shape,)
    if dtype.kind != kind or found_shape not in shapes or dtype.itemsize > (LARGEST if kind == "U" else 8):
        raise ValueError(f"{name}: {dtype} of shape {found_shape} is invalid: expected {kind} {shape}")


def _require_values(arrays: dict[str, np.ndarray]) -> None:
    for name, value in arrays.items():
        if value.dtype.kind == "f" and not np.isfinite(value).all():
            raise ValueError(f"{name}: expected finite numbers")
    for name in QUANTITIES:
        least, most = allowed_range(name)
        if not least <= (value := float(arrays.get(f"physics_{name}", least))) <= most:
            raise ValueError(f"physics_{name}: {value:g} is invalid: expected {least} to {most}")
    n_types = config_from_yaml(str(arrays["config"])).scene.n_types
    ends = {"peg_type": n_types, "hole_type": n_types, "policy": OWN + 1, "horizon": MAX_HORIZON + 1}
    for name, end in (*ends.items(), ("step", int(arrays["horizon"]))):
        if not 0 <= int(arrays[name]) < end:
            raise ValueError(f"{name}: {int(arrays[name])} is invalid: expected 0 to {end - 1}")
