"""Provenance of results: versions, device, data."""

import hashlib
import platform
import re
from importlib.metadata import version
from pathlib import Path

import h5py
import jax
import numpy as np

from mjx_fit.utils import numerics

CPU_INFO = Path("/proc/cpuinfo")

PACKAGES = (
    "mjx-fit",
    "mujoco",
    "mujoco-mjx",
    "jax",
    "jaxlib",
    "flax",
    "optax",
    "orbax-checkpoint",
    "numpy",
    "scipy",
    "h5py",
)


def versions() -> dict[str, str]:
    """Return the versions of Python and of each library that results may depend on.

    Process settings that change arithmetic, such as ``XLA_FLAGS``, are separate entries in capitals; an
    ordinary shell has none.
    """
    libraries = {name: version(name) for name in PACKAGES}
    hdf5 = {"hdf5": h5py.version.hdf5_version}
    return {"python": platform.python_version()} | libraries | hdf5 | numerics.carried()


def differing(one: dict[str, str], other: dict[str, str]) -> list[tuple[str, str, str]]:
    """List the entries that differ between two records of ``versions``, with name and both values."""
    names = sorted(one.keys() | other.keys())
    pairs = [(name, one.get(name, "not set"), other.get(name, "not set")) for name in names]
    return [(name, first, second) for name, first, second in pairs if first != second]


def settings_of(record: dict[str, str]) -> dict[str, str]:
    """Return the entries of a record of ``versions`` that are process settings."""
    return {name: value for name, value in record.items() if name.isupper()}


def device() -> str:
    """Return platform and kind of JAX's device; for a CPU its model, if known."""
    first = jax.devices()[0]
    kind = first.device_kind
    if first.platform == "cpu" and CPU_INFO.is_file():
        told = re.search(r"^model name\s*:\s*(.+)$", CPU_INFO.read_text(errors="replace"), re.MULTILINE)
        kind = told[1] if told else platform.machine()
    return f"{first.platform}: {kind}"


def fingerprint(tree) -> str:
    """Compute the SHA-256 over all arrays of a pytree, including their types and shapes."""
    digest = hashlib.sha256()
    for leaf in jax.tree.leaves(tree):
        array = np.ascontiguousarray(leaf)
        digest.update(f"{array.dtype}{array.shape}".encode())
        digest.update(array.data)
    return digest.hexdigest()
