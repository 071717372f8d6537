"""Draw the physics of randomised worlds, and the sizes of measurement errors."""

import copy

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
    sections = {"wrist": copy.copy(config.wrist), "pose": copy.copy(config.pose)}
    for name, value in drawn.items():
        # The sections' own checks accept numbers only, not arrays.
        object.__setattr__(sections[MEASURED[name]], name, value)
    return sections["wrist"], sections["pose"]


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
