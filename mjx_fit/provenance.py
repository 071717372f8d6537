"""What a result was made with: versions, device, data."""

import hashlib
import platform
from importlib.metadata import version

import jax
import numpy as np

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
)


def versions() -> dict[str, str]:
    """Version of Python and of each library that a number may depend on."""
    return {"python": platform.python_version()} | {name: version(name) for name in PACKAGES}


def device() -> str:
    """Platform and kind of the device that JAX computes on."""
    first = jax.devices()[0]
    return f"{first.platform}: {first.device_kind}"


def fingerprint(tree) -> str:
    """SHA-256 over all arrays of a pytree, with their types and shapes."""
    digest = hashlib.sha256()
    for leaf in jax.tree.leaves(tree):
        array = np.ascontiguousarray(leaf)
        digest.update(f"{array.dtype}{array.shape}".encode())
        digest.update(array.data)
    return digest.hexdigest()
