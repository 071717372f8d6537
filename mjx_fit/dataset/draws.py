"""What the episodes of a data set are to do: pure functions of a root key and ids."""

from functools import partial
from itertools import permutations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, Key

from mjx_fit import policies
from mjx_fit.config import Config
from mjx_fit.detector import detect
from mjx_fit.robot import PANDA, Robot
from mjx_fit.settings import N_TYPES, DetectorConfig, SequenceConfig
from mjx_fit.types import Array, Attempt

POLICIES = (*policies.NAMES, "mixed")
MISMATCHED = np.array(list(permutations(range(N_TYPES), 2)))


def pair_of(sequences: Int[np.ndarray, "n"]) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "n"]]:
    """Peg and hole type of each sequence: even ids take the matched pairs in turn, odd ids the others."""
    turn = sequences // 2
    matched = (sequences % 2 == 0)[:, None]
    same = np.stack([turn % N_TYPES] * 2, 1)
    pair = np.where(matched, same, MISMATCHED[turn % len(MISMATCHED)])
    return pair[:, 0], pair[:, 1]


def policy_of(policy: str, sequences: Int[np.ndarray, "n"], number: int) -> Int[np.ndarray, "n"]:
    """Index of the policy of each sequence's attempt; ``mixed`` takes turns, in all pairs alike."""
    if policy == "mixed":
        turn = sequences // 2
        # The pairs of a turn come again after 3 and after 6 turns: a shift every 6 lets them alternate, too.
        return (turn + turn // len(MISMATCHED) + number) % len(policies.NAMES)
    return np.full(len(sequences), policies.NAMES.index(policy))


def draw_attempts(
    root: Key[Array, ""], sequences: Int[Array, "n"], policy: str, detector: DetectorConfig
) -> Attempt:
    """The first attempt of each sequence, from the detector's estimate."""
    hole_pos, estimate, wiggle, _ = draw_places(root, sequences, detector)
    return _attempts(sequences, policy, 0, hole_pos, estimate, wiggle)


def draw_later_attempts(
    root: Key[Array, ""], sequences: Int[Array, "n"], policy: str, number: int, config: Config
) -> tuple[Attempt, Float[Array, "n 2 2"]]:
    """Attempt ``number`` (1 or more) of each sequence, and the covariance of its estimate (m²)."""
    hole_pos, _, _, later = draw_places(root, sequences, config.detector)
    estimate, cov, wiggle = _updated(later, hole_pos, number, config.sequence)
    return _attempts(sequences, policy, number, hole_pos, estimate, wiggle), cov


@partial(jax.jit, static_argnames=("detector", "robot"))
def draw_places(
    root: Key[Array, ""], ids: Int[Array, "n"], detector: DetectorConfig, robot: Robot = PANDA
) -> tuple[Float[Array, "n 2"], Float[Array, "n 2"], Key[Array, "n"], Key[Array, "n"]]:
    """Where the holes are, what the detector says, and keys.

    Args:
        root: Root key.
        ids: Each draw depends on the root key and its own id alone.
        detector: The detector.
        robot: Gives the workspace.

    Returns:
        True places, uniform in the workspace, m; estimates, m; keys of the policies; keys of later attempts.
    """

    def draw(i):
        place, error, wiggle, later = jax.random.split(jax.random.fold_in(root, i), 4)
        low, high = jnp.asarray(robot.workspace_m).T
        hole_pos = jax.random.uniform(place, (2,), minval=low, maxval=high)
        return hole_pos, detect(error, hole_pos, detector), wiggle, later

    return jax.vmap(draw)(ids)


@partial(jax.jit, static_argnames="config")
def _updated(
    keys: Key[Array, "n"], hole_pos_world: Float[Array, "n 2"], number: int, config: SequenceConfig
) -> tuple[Float[Array, "n 2"], Float[Array, "n 2 2"], Key[Array, "n"]]:
    """Estimates as a filter could have them after some attempts: N(truth, Σ), with Σ of any direction."""

    def draw(key, hole_pos):
        size, turn, error, wiggle = jax.random.split(jax.random.fold_in(key, number), 4)
        low, high = jnp.log(config.min_std_m), jnp.log(config.max_std_m)
        std = jnp.exp(jax.random.uniform(size, (2,), minval=low, maxval=high))
        angle = jax.random.uniform(turn, maxval=jnp.pi)
        axes = jnp.array([[jnp.cos(angle), -jnp.sin(angle)], [jnp.sin(angle), jnp.cos(angle)]])
        estimate = hole_pos + axes @ (std * jax.random.normal(error, (2,)))
        return estimate, (axes * std**2) @ axes.T, wiggle

    return jax.vmap(draw)(keys, hole_pos_world)


def _attempts(sequences, policy, number, hole_pos, estimate, key) -> Attempt:
    ids = np.asarray(sequences)
    peg_type, hole_type = pair_of(ids)
    kind = jnp.asarray(policy_of(policy, ids, number))
    return Attempt(jnp.asarray(peg_type), jnp.asarray(hole_type), hole_pos, estimate, kind, key)
