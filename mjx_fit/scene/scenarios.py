"""Scenarios of the assembly experiment: holes, pegs and detector estimates, drawn from the trial's id."""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from mjx_fit.config.schema import Config
from mjx_fit.scene.build import place_holes
from mjx_fit.scene.detector import detect
from mjx_fit.scene.randomization import draw_physics
from mjx_fit.types.physics import AS_CONFIGURED, Physics
from mjx_fit.utils.randomness import root_key


@dataclass(frozen=True)
class Trials:
    """Holes, pegs and detector estimates of T trials with n holes each.

    Attributes:
        trial: Ids (T,), which determine all draws.
        hole_type: Types of the holes (T, n).
        hole_pos_world: True centres of the holes (T, n, 2), m.
        estimate_world: Detector estimates of the centres (T, n, 2), m.
        peg_type: Types of the pegs (T, n) in grasping order.
        physics: Quantities that the world of each hole has of its own, (T, n).
    """

    trial: Int[np.ndarray, "T"]
    hole_type: Int[np.ndarray, "T n"]
    hole_pos_world: Float[np.ndarray, "T n 2"]
    estimate_world: Float[np.ndarray, "T n 2"]
    peg_type: Int[np.ndarray, "T n"]
    physics: Physics = AS_CONFIGURED


def draw_trials(config: Config, seed: int, trials: Int[np.ndarray, "T"]) -> Trials:
    """Draw holes of random types and positions, matching pegs in random order, and detector estimates."""
    n = config.task.n_holes
    rngs = [np.random.default_rng([seed, trial]) for trial in trials]
    hole_type = np.stack([rng.integers(config.scene.n_types, size=n) for rng in rngs])
    peg_type = np.stack([rng.permutation(row) for rng, row in zip(rngs, hole_type, strict=True)])
    hole_pos = np.stack([place_holes(rng, n, config.scene) for rng in rngs]).astype(np.float32)
    fold = jax.vmap(jax.random.fold_in, (None, 0))
    of_trial = fold(root_key(seed, "assembly: detector"), jnp.asarray(trials))
    keys = jax.vmap(fold, (0, None))(of_trial, jnp.arange(n))
    estimate = jax.vmap(jax.vmap(partial(detect, config=config.detector)))(keys, jnp.asarray(hole_pos))
    worlds = jax.vmap(fold, (0, None))(
        fold(root_key(seed, "assembly: physics"), jnp.asarray(trials)), jnp.arange(n)
    )
    draw = jax.vmap(jax.vmap(partial(draw_physics, randomize=config.randomize)))
    physics = jax.tree.map(np.asarray, draw(worlds))
    return Trials(np.asarray(trials), hole_type, hole_pos, np.asarray(estimate), peg_type, physics)
