"""XLA options with which MJX rollouts are compiled."""

from functools import cache

import jax
import jax.numpy as jnp

_WITHOUT_EMITTERS = {"xla_cpu_use_fusion_emitters": False}


def compiler_options() -> dict[str, bool]:
    """Return the XLA options that disable the fusion emitters on a CPU.

    The emitters recompute the kinematic chain for every element, which is 200 times slower. JAX 0.11 dropped
    the option; its improved emitters cost a factor of two.
    """
    return _WITHOUT_EMITTERS if jax.default_backend() == "cpu" and _can_do_without_emitters() else {}


@cache
def _can_do_without_emitters() -> bool:
    try:
        jax.jit(jnp.negative, compiler_options=_WITHOUT_EMITTERS).lower(0.0).compile()
    except jax.errors.JaxRuntimeError:
        return False
    return True
