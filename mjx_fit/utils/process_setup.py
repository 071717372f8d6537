"""Process-wide settings that commands apply. The library itself leaves them to its caller."""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

import ctypes
import os
import sys

import jax

from mjx_fit.utils import compilation_cache, numerics


def pin() -> None:
    """Pin the settings that random draws and arithmetic depend on; name overridden variables."""
    for name, value in numerics.pin().items():
        asked = os.environ.get(name.upper())
        if asked is not None:
            print(
                f"mjx-fit: {name.upper()}={asked} is not used: commands compute with {value}", file=sys.stderr
            )


def configure() -> None:
    """Set up JAX and MuJoCo for a command. Call it before anything is computed.

    - Settings that determine random draws and arithmetic are pinned (``pin``).
    - Compiled computations are cached in ``compilation_cache.CACHE``, unless the user's settings name another
      folder; damaged entries are compiled again.
    - CPU computations run in the calling thread. Dispatching each of them to another thread costs the native
      engine a tenth of its speed.
    - Freed memory stays with the process. XLA allocates all memory of a computation at once and frees it
      afterwards; getting it page by page from the system took a quarter of the time of a training step.
    - MuJoCo's warnings are not written to a file in the working folder: diverged simulations are reported by
      name.

    Example:
        >>> import mjx_fit as mf
        >>> mf.configure()  # first in a script; commands do so by themselves
    """
    import mujoco  # here, so that commands that only read files need not wait for it

    pin()
    _keep_compiled()
    jax.config.update("jax_cpu_enable_async_dispatch", False)
    _keep_memory()
    mujoco.set_mju_user_warning(lambda message: None)


def _keep_compiled() -> None:
    path = compilation_cache.folder(jax.config.jax_compilation_cache_dir)
    jax.config.update("jax_raise_persistent_cache_errors", False)
    jax.config.update("jax_compilation_cache_dir", None if path is None else str(path))
    if path is not None:
        compilation_cache.replace_damaged(path)


_M_TRIM_THRESHOLD, _M_MMAP_MAX = -1, -4
"""Parameters of glibc's ``mallopt``, from malloc.h."""


def _keep_memory() -> None:
    """Configure malloc, where it is glibc's, neither to map large blocks nor to return them to the system."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        mallopt(_M_MMAP_MAX, 0)
        mallopt(_M_TRIM_THRESHOLD, 2**31 - 1)
