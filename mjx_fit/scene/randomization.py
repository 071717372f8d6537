"""Draw the physics of randomised worlds, and the sizes of measurement errors."""

import copy
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Float, Key

from mjx_fit.config.quantities import MEASURED, QUANTITIES
from mjx_fit.config.randomized import Distributions, distributions
from mjx_fit.config.schema import Config
from mjx_fit.config.sections.measurement import PoseConfig, WristConfig
from mjx_fit.config.sections.randomize import MOST_SIGMA, Distribution, RandomizeConfig
from mjx_fit.types import Array
from mjx_fit.types.physics import Physics

S = TypeVar("S")


def draw_physics(key: Key[Array, ""], randomize: RandomizeConfig) -> Physics:
    """Draw the quantities of one world; those without a distribution stay None.

    The draw of a quantity depends on the key and its own distribution alone.

    Args:
        key: Random key of the world.
        randomize: The distributions.
    """
    return Physics(**_values(key, distributions(randomize), tuple(QUANTITIES)))


def draw_errors(key: Key[Array, ""], config: Config) -> tuple[WristConfig, PoseConfig]:
    """Return the sections ``wrist`` and ``pose``, with values drawn where ``randomize`` has a distribution.

    Drawn values are arrays, which may be traced.

    Args:
        key: Random key of the reading.
        config: The configuration.
    """
    drawn = _values(key, distributions(config.randomize, MEASURED), tuple(MEASURED))
    wrist, pose = (
        {name: value for name, value in drawn.items() if MEASURED[name] == section}
        for section in ("wrist", "pose")
    )
    return with_arrays(config.wrist, **wrist), with_arrays(config.pose, **pose)


def with_arrays(section: S, **values: Any) -> S:
    """Return a section with other values, which may be traced: its own checks accept numbers only."""
    changed = copy.copy(section)
    for name, value in values.items():
        object.__setattr__(changed, name, value)
    return changed


def _values(key, named: Distributions, order: tuple[str, ...]) -> dict[str, Float[Array, ""]]:
    return {name: _draw(jax.random.fold_in(key, order.index(name)), one) for name, one in named.items()}


def _draw(key: Key[Array, ""], distribution: Distribution) -> Float[Array, ""]:
    low, high = distribution.support
    if distribution.uniform is not None:
        value = jax.random.uniform(key, minval=low, maxval=high)
    elif distribution.log_uniform is not None:
        value = jnp.exp(jax.random.uniform(key, minval=jnp.log(low), maxval=jnp.log(high)))
    elif distribution.normal is not None:
        mean, std = distribution.normal
        value = mean + std * jnp.clip(jax.random.normal(key), -MOST_SIGMA, MOST_SIGMA)
    else:
        values = jnp.asarray(distribution.choice, jnp.float32)
        value = values[jax.random.randint(key, (), 0, len(values))]
    # Rounding must not leave the support, whose ends may be bounds of the physics.
    return jnp.clip(value, low, high)
