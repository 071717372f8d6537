"""What a result was made with: versions, device, data."""

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
    """Version of Python and of each library that a number may depend on.

    A setting of the process that changes arithmetic, such as ``XLA_FLAGS``, is an entry of its own, in
    capitals; there is none in an ordinary shell.
    """
    libraries = {name: version(name) for name in PACKAGES}
    hdf5 = {"hdf5": h5py.version.hdf5_version}
    return {"python": platform.python_version()} | libraries | hdf5 | numerics.carried()


def differing(one: dict[str, str], other: dict[str, str]) -> list[tuple[str, str, str]]:
    """The entries in which two records of ``versions`` differ, whichever side has them: name and values."""
    names = sorted(one.keys() | other.keys())
    pairs = [(name, one.get(name, "not set"), other.get(name, "not set")) for name in names]
    return [(name, first, second) for name, first, second in pairs if first != second]


def settings_of(record: dict[str, str]) -> dict[str, str]:
    """The entries of a record of ``versions`` that are settings of the process."""
    return {name: value for name, value in record.items() if name.isupper()}


def device() -> str:
    """Platform and kind of the device that JAX computes on; of a CPU its model, as far as it is told."""
    first = jax.devices()[0]
    kind = first.device_kind
    if first.platform == "cpu" and CPU_INFO.is_file():
        told = re.search(r"^model name\s*:\s*(.+)$", CPU_INFO.read_text(errors="replace"), re.MULTILINE)
        kind = told[1] if told else platform.machine()
    return f"{first.platform}: {kind}"


def fingerprint(tree) -> str:
    """SHA-256 over all arrays of a pytree, with their types and shapes."""
    digest = hashlib.sha256()
    for leaf in jax.tree.leaves(tree):
        array = np.ascontiguousarray(leaf)
        digest.update(f"{array.dtype}{array.shape}".encode())
        digest.update(array.data)
    return digest.hexdigest()
