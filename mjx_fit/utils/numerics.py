"""Process-wide settings that random draws and arithmetic depend on: set by commands, checked by the library.

JAX and NumPy keep them for the whole process: an environment variable, or a line in a notebook, would
otherwise silently change every number.
"""

import enum
import os
from functools import cache
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Key

from mjx_fit.utils.errors import RequestError

KEY_IMPL = "threefry2x32"
"""Random number generator of JAX keys, stated explicitly wherever a key is created."""

_UNGUARDED = (None, "allow", "log", "log_explicit")

PINNED: dict[str, tuple[Any, ...]] = {
    # Options that change random draws:
    "jax_enable_x64": (False,),
    "jax_default_prng_impl": (KEY_IMPL,),
    "jax_threefry_partitionable": (True,),
    "jax_random_seed_offset": (0,),
    "jax_high_dynamic_range_gumbel": (False,),
    # Options that change arithmetic:
    "jax_default_matmul_precision": (None,),
    "jax_numpy_dtype_promotion": ("standard",),
    "jax_disable_jit": (False,),
    "jax_disable_most_optimizations": (False,),
    "jax_exec_time_optimization_effort": (0.0,),
    "jax_memory_fitting_effort": (0.0,),
    "jax_memory_fitting_level": ("O2",),
    "jax_optimization_level": ("UNKNOWN",),
    "jax_softmax_custom_jvp": (False,),
    "jax_use_direct_linearize": (True,),
    "jax_compiler_enable_remat_pass": (True,),
    "eager_constant_folding": (False,),
    # Options that make correct code raise:
    "jax_numpy_rank_promotion": ("allow", "warn"),
    "jax_explicit_x64_dtypes": ("warn", "allow"),
    "jax_legacy_prng_key": ("allow", "warn"),
    "jax_transfer_guard": _UNGUARDED,
    "jax_transfer_guard_host_to_device": _UNGUARDED,
    "jax_transfer_guard_device_to_device": _UNGUARDED,
    "jax_transfer_guard_device_to_host": _UNGUARDED,
    "jax_array_garbage_collection_guard": (None, "allow", "log"),
    "jax_debug_nans": (False,),
    "jax_debug_infs": (False,),
    "jax_debug_key_reuse": (False,),
    "jax_check_tracer_leaks": (False,),
    "jax_enable_checks": (False,),
    "jax_error_checking_behavior_nan": ("ignore",),
    "jax_error_checking_behavior_divide": ("ignore",),
    "jax_error_checking_behavior_oob": ("ignore",),
    "jax_thread_guard": (False,),
    "jax_no_tracing": (False,),
    "jax_no_execution": (False,),
}
"""Options of JAX with their allowed values; commands set the first. Options unknown to the installed JAX are
ignored."""

_CARRIED = {
    "NPY_DISABLE_CPU_FEATURES",
    "NPY_ENABLE_CPU_FEATURES",
    "NVIDIA_TF32_OVERRIDE",
    "OPENBLAS_CORETYPE",
    "XLA_FLAGS",
}
"""Environment variables that change arithmetic but have legitimate uses."""

_HARMLESS = {
    "JAX_PLATFORMS",
    "JAX_PLATFORM_NAME",
    "JAX_CUDA_VISIBLE_DEVICES",
    "JAX_ROCM_VISIBLE_DEVICES",
    "JAX_CPU_ENABLE_ASYNC_DISPATCH",
    "JAX_LOG_COMPILES",
    "JAX_LOGGING_LEVEL",
    "JAX_DEBUG_LOG_MODULES",
    "JAX_EXPLAIN_CACHE_MISSES",
    "JAX_TRACEBACK_FILTERING",
    "JAX_INCLUDE_FULL_TRACEBACKS_IN_LOCATIONS",
    "JAX_RAISE_PERSISTENT_CACHE_ERRORS",
    "JAX_ENABLE_COMPILATION_CACHE",
    "JAX_ENABLE_CUSTOM_PRNG",  # changes the type of legacy keys, which are not used
    "JAX_DUMP_IR_TO",
    "JAX_INCLUDE_DEBUG_INFO_IN_DUMPS",
    "JAX_TRACEBACK_IN_LOCATIONS_LIMIT",
    "JAX_TRACER_ERROR_NUM_TRACEBACK_FRAMES",
    "JAX_LOG_CHECKPOINT_RESIDUALS",
    "JAX_DUMP_IR_MODES",
    "JAX_PPRINT_USE_COLOR",
    "JAX_CAPTURED_CONSTANTS_WARN_BYTES",
    "JAX_CAPTURED_CONSTANTS_REPORT_FRAMES",
}
_HARMLESS_BEGINNINGS = ("JAX_COMPILATION_CACHE_", "JAX_PERSISTENT_CACHE_")
"""Variables of JAX for devices, caches and messages. Any other variable may change arithmetic."""


def pin() -> dict[str, Any]:
    """Set every option of ``PINNED`` for the process, and NumPy's handling of floating-point errors.

    Returns:
        Options whose values were not allowed, with their new values.
    """
    changed = {}
    for name, allowed in _present().items():
        if (value := _value(name)) != allowed[0]:
            jax.config.update(name, allowed[0])
            if value not in allowed:
                changed[name] = allowed[0]
    np.seterr(divide="warn", over="warn", under="ignore", invalid="warn")
    return changed


def require() -> None:
    """Check the process before anything is drawn or computed; called by every public entry point.

    Raises:
        RequestError: An option of JAX or NumPy would change draws or arithmetic, or let correct code raise.
    """
    for name, allowed in _present().items():
        if (value := _value(name)) not in allowed:
            raise RequestError(
                f"{name}: {value!r} cannot be used with mjx_fit, whose results depend on it: "
                f"expected {' or '.join(map(repr, allowed))}; "
                f"set it with jax.config.update({name!r}, {allowed[0]!r})"
            )
    raising = sorted(name for name, what in np.geterr().items() if what == "raise")
    if raising:
        raise RequestError(
            f"numpy.seterr: {raising[0]}='raise' cannot be used with mjx_fit: expected 'ignore' or 'warn'"
        )


def key(seed: int) -> Key[Array, ""]:
    """Create a random key, independent of JAX's default implementation."""
    return jax.random.key(seed, impl=KEY_IMPL)


def carried() -> dict[str, str]:
    """List the environment variables that change arithmetic; results with different ones must not be mixed.

    The result is empty in an ordinary shell.
    """
    found = {name: " ".join(os.environ[name].split()) for name in os.environ if _is_carried(name)}
    if "XLA_FLAGS" in found:
        found["XLA_FLAGS"] = _flags(os.environ["XLA_FLAGS"])
    return {name: value for name, value in sorted(found.items()) if value}


@cache
def _present() -> dict[str, tuple[Any, ...]]:
    there = jax.config.values
    return {name: allowed for name, allowed in PINNED.items() if name in there}


def _value(name: str) -> Any:
    """Return the current value of an option, also inside ``with jax.enable_x64(True)``."""
    value = getattr(jax.config, name) if hasattr(jax.config, name) else jax.config.values[name]
    return value.name.lower() if isinstance(value, enum.Enum) else value


def _is_carried(name: str) -> bool:
    if name in _CARRIED:
        return True
    of_jax = name.startswith("JAX_") and name not in _HARMLESS and name.lower() not in PINNED
    return of_jax and not name.startswith(_HARMLESS_BEGINNINGS)


def _flags(text: str) -> str:
    """Sort XLA's flags, which may be in a file named by the variable; dump flags change nothing."""
    text = text.strip()
    if text and not text.startswith("-"):
        try:
            with open(text, encoding="utf-8") as file:
                text = file.read()
        except (OSError, ValueError):
            return text
    return " ".join(sorted(flag for flag in set(text.split()) if not flag.startswith("--xla_dump")))
