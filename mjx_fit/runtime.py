"""Settings of the process that a command runs in. The library itself leaves them to its caller."""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

import ctypes
import sys
from pathlib import Path

import jax
import mujoco
import platformdirs

CACHE = Path(platformdirs.user_cache_dir("mjx_fit"))
"""Where what can be made again is kept."""


def configure() -> None:
    """Sets JAX and MuJoCo up for a command. Call it before anything is computed.

    - Compiled computations are kept in ``CACHE``, unless the user's own setting names another place.
    - On a CPU, computations run in the thread that asks for them. Handing each of them to another thread
      costs the native engine a tenth of its speed.
    - Memory that is freed stays with the process. XLA takes all that a computation needs at once and gives it
      back; from the system it comes page by page, which took a quarter of the time of a training step.
    - MuJoCo's warnings do not end up in a file in the working folder: a broken world is reported by name.
    """
    if jax.config.jax_compilation_cache_dir is None:
        jax.config.update("jax_compilation_cache_dir", str(CACHE / "xla"))
    jax.config.update("jax_cpu_enable_async_dispatch", False)
    _keep_memory()
    mujoco.set_mju_user_warning(lambda message: None)


_M_TRIM_THRESHOLD, _M_MMAP_MAX = -1, -4
"""Parameters of glibc's ``mallopt``; see malloc.h."""


def _keep_memory() -> None:
    """Asks the C library, if it can be asked, neither to map large blocks nor to return them."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        mallopt(_M_MMAP_MAX, 0)
        mallopt(_M_TRIM_THRESHOLD, 2**31 - 1)
