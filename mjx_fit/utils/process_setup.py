"""Settings of the process that a command runs in. The library itself leaves them to its caller."""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

import ctypes
import os
import sys

import jax

from mjx_fit.utils import compilation_cache, numerics


def pin() -> None:
    """Sets what draws and arithmetic depend on, whatever the environment asks for, and says so if it does."""
    for name, value in numerics.pin().items():
        asked = os.environ.get(name.upper())
        if asked is not None:
            print(
                f"mjx-fit: {name.upper()}={asked} is not used: commands compute with {value}", file=sys.stderr
            )


def configure() -> None:
    """Sets JAX and MuJoCo up for a command. Call it before anything is computed.

    - What draws and arithmetic depend on is pinned (``pin``).
    - Compiled computations are kept in ``compiled.CACHE``, unless the user's own setting names another place;
      what is damaged there is made again.
    - On a CPU, computations run in the thread that asks for them. Handing each of them to another thread
      costs the native engine a tenth of its speed.
    - Memory that is freed stays with the process. XLA takes all that a computation needs at once and gives it
      back; from the system it comes page by page, which took a quarter of the time of a training step.
    - MuJoCo's warnings do not end up in a file in the working folder: a broken world is reported by name.

    Example:
        >>> import mjx_fit as mf
        >>> mf.configure()  # first in a script; commands do so by themselves
    """
    import mujoco  # here, so that commands that only look at files need not wait for it

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
"""Parameters of glibc's ``mallopt``; see malloc.h."""


def _keep_memory() -> None:
    """Asks the C library, if it can be asked, neither to map large blocks nor to return them."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        mallopt(_M_MMAP_MAX, 0)
        mallopt(_M_TRIM_THRESHOLD, 2**31 - 1)
