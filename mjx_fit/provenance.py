"""What a result was made with: versions, device, data."""

import hashlib
import platform
import re
from importlib.metadata import version
from pathlib import Path

import h5py
import jax
import numpy as np

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
    """Version of Python and of each library that a number may depend on."""
    libraries = {name: version(name) for name in PACKAGES}
    return {"python": platform.python_version()} | libraries | {"hdf5": h5py.version.hdf5_version}


def device() -> str:
    """Platform and kind of the device that JAX computes on; of a CPU its model, as far as it is told."""
    first = jax.devices()[0]
    kind = first.device_kind
    if first.platform == "cpu" and CPU_INFO.is_file():
        told = re.search(r"^model name\s*:\s*(.+)$", CPU_INFO.read_text(), re.MULTILINE)
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
