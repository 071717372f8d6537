"""States of the policy ``seek`` for its tests."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from mjx_fit.control import search
from mjx_fit.task.seek import Thought
from mjx_fit.types import Belief


def thought(belief: Belief, *, path_m: float, centre=(0.0, 0.0), touched=True) -> Thought:
    state = replace(
        search.begin(jnp.asarray(centre)), path_m=jnp.asarray(path_m), touched=jnp.asarray(touched)
    )
    return Thought(None, belief, belief, state, jnp.zeros((), bool))


def belief_of(mean, std, match=1 / 3) -> Belief:
    logp = np.log([match, (1 - match) / 2, (1 - match) / 2])
    return Belief(jnp.asarray(mean), std**2 * jnp.eye(2), jnp.asarray(logp))
