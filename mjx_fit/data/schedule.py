"""Draw the attempts of a data set: pure functions of a root key and ids."""

from dataclasses import replace
from functools import partial
from itertools import permutations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, Key

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.randomize import RandomizeConfig
from mjx_fit.config.sections.world import DetectorConfig
from mjx_fit.control import policies
from mjx_fit.filters import chart
from mjx_fit.filters.updates import detected_belief, prior_stds
from mjx_fit.scene.detector import detect
from mjx_fit.scene.placement import place_for_tool
from mjx_fit.scene.randomization import draw_physics
from mjx_fit.scene.robot import ROBOTS, Robot
from mjx_fit.types import Array, Attempt, pytree
from mjx_fit.types.physics import Physics

POLICIES = (*policies.NAMES, "mixed")


def stored_policies(policy: str) -> tuple[str, ...]:
    """Return the names that the policy index of a data set refers to; a custom policy comes last."""
    return policies.NAMES if policy in POLICIES else (*policies.NAMES, policy)


def mismatched_pairs(n_types: int) -> Int[np.ndarray, "pairs 2"]:
    """Return peg and hole type of every mismatched pair; empty for a single type."""
    return np.array(list(permutations(range(n_types), 2)), int).reshape(-1, 2)


def pair_of(
    sequences: Int[np.ndarray, "n"], n_types: int
) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "n"]]:
    """Return peg and hole type of each sequence: even ids take matched pairs in turn, odd ids others."""
    turn = sequences // 2
    pair = np.stack([turn % n_types] * 2, 1)
    others = mismatched_pairs(n_types)
    if len(others):
        matched = (sequences % 2 == 0)[:, None]
        pair = np.where(matched, pair, others[turn % len(others)])
    return pair[:, 0], pair[:, 1]


def policy_of(
    policy: str, sequences: Int[np.ndarray, "n"], number: int, n_types: int
) -> Int[np.ndarray, "n"]:
    """Return the policy index of each sequence's attempt; ``mixed`` alternates within every pair.

    Any other name means a custom policy.
    """
    if policy == "mixed":
        turn = sequences // 2
        return (turn + _shifts(turn, n_types) + number) % len(policies.NAMES)
    names = policies.NAMES
    return np.full(len(sequences), names.index(policy) if policy in names else policies.OWN)


def _shifts(turn: Int[np.ndarray, "n"], n_types: int) -> Int[np.ndarray, "n"]:
    """Return shifts that make a pair alternate policies even if it repeats after an even number of turns.

    A matched pair repeats after C turns, a mismatched pair after C (C - 1).
    """
    if n_types == 1:
        return np.zeros_like(turn)
    return turn // (n_types if n_types % 2 == 0 else n_types * (n_types - 1))


def draw_attempts(root: Key[Array, ""], sequences: Int[Array, "n"], policy: str, config: Config) -> Attempt:
    """Draw the first attempt of each sequence, from the detector's estimate."""
    places = draw_places(root, sequences, config)
    which = _pair_and_policy(sequences, policy, 0, config)
    return _attempts(which, places, detected_belief(places.estimate_world, config).mean_world, places.key)


def draw_matching(key: Key[Array, ""], config: Config) -> Attempt:
    """Draw the attempt of one peg at its own hole, of any type, within a compiled function."""
    which, world = jax.random.split(key)
    own = jax.random.randint(which, (1,), 0, config.scene.n_types)
    places = draw_places(world, jnp.zeros(1, jnp.int32), config)
    estimate = detected_belief(places.estimate_world, config).mean_world
    kind = jnp.full(1, policies.SPIRAL)
    return jax.tree.map(lambda leaf: leaf[0], _attempts((own, own, kind), places, estimate, places.key))


def draw_later_attempts(
    root: Key[Array, ""],
    sequences: Int[Array, "n"],
    policy: str,
    number: int,
    config: Config,
    left: Physics | None = None,
) -> tuple[Attempt, Float[Array, "n D D"]]:
    """Draw attempt ``number`` (1 or more) of each sequence, and the covariance of its estimate (m², rad²).

    ``left`` is the physics that the attempt before left, where pegs slip in the hand.
    """
    places = draw_places(root, sequences, config)
    places = places if left is None else replace(places, physics=left)
    estimate, cov, key = _updated(places, number, config)
    which = _pair_and_policy(sequences, policy, number, config)
    return _attempts(which, places, estimate, key), cov


@pytree
class Places:
    """Holes, their detections, and the worlds that they are in.

    Attributes:
        hole_pos_world: True positions, uniform in the workspace, m.
        estimate_world: Estimates of the detector, m.
        key: Keys of policies.
        later_key: Keys of later attempts.
        physics: Quantities that each world has of its own.
    """

    hole_pos_world: Float[Array, "n 2"]
    estimate_world: Float[Array, "n 2"]
    key: Key[Array, "n"]
    later_key: Key[Array, "n"]
    physics: Physics


def draw_places(root: Key[Array, ""], ids: Int[Array, "n"], config: Config) -> Places:
    """Draw holes, detections and worlds.

    Args:
        root: Root key.
        ids: Ids; each draw depends on the root key and its own id alone.
        config: Defines the detector, the robot's workspace and the distributions of the physics.
    """
    return _places(root, ids, config.detector, config.randomize, ROBOTS[config.scene.robot])


@partial(jax.jit, static_argnames=("detector", "randomize", "robot"))
def _places(
    root: Key[Array, ""],
    ids: Int[Array, "n"],
    detector: DetectorConfig,
    randomize: RandomizeConfig,
    robot: Robot,
) -> Places:
    def draw(i):
        place, error, wiggle, later, world = jax.random.split(jax.random.fold_in(root, i), 5)
        low, high = jnp.asarray(robot.workspace_m).T
        hole_pos = jax.random.uniform(place, (2,), minval=low, maxval=high)
        physics = draw_physics(world, randomize)
        return Places(hole_pos, detect(error, hole_pos, detector), wiggle, later, physics)

    return jax.vmap(draw)(ids)


@partial(jax.jit, static_argnames="config")
def _updated(
    places: Places, number: int, config: Config
) -> tuple[Float[Array, "n D"], Float[Array, "n D D"], Key[Array, "n"]]:
    """Draw estimates that resemble a filter's after some attempts: N(truth, Σ), Σ with random orientation.

    Height and rotations err independently of x and y, by as much in their units (``chart.units``), but not by
    more than before any attempt.
    """
    between, coordinates = config.sequence, config.filter.coordinates
    low, high = jnp.log(between.min_std_m), jnp.log(between.max_std_m)
    scale = np.array(chart.units(coordinates)[2:], np.float32) / chart.units(("x",))[0]
    most = np.array(prior_stds(config)[2:], np.float32)

    def draw(key, place):
        size, turn, error, wiggle = jax.random.split(jax.random.fold_in(key, number), 4)
        std = jnp.exp(jax.random.uniform(size, (2,), minval=low, maxval=high))
        angle = jax.random.uniform(turn, maxval=jnp.pi)
        axes = jnp.array([[jnp.cos(angle), -jnp.sin(angle)], [jnp.sin(angle), jnp.cos(angle)]])
        step, cov = axes @ (std * jax.random.normal(error, (2,))), (axes * std**2) @ axes.T
        if not scale.size:
            return place + step, cov, wiggle
        also, rest = (jax.random.fold_in(one, 1) for one in (size, error))
        more = jnp.exp(jax.random.uniform(also, scale.shape, minval=low, maxval=high))
        more = jnp.minimum(more * scale, most)
        step = jnp.concatenate([step, more * jax.random.normal(rest, scale.shape)])
        cov = jax.scipy.linalg.block_diag(cov, jnp.diag(more**2))
        return chart.moved(place, step, coordinates), cov, wiggle

    true = place_for_tool(places.hole_pos_world, places.physics, config)
    return jax.vmap(draw)(places.later_key, true)


def _pair_and_policy(sequences, policy: str, number: int, config: Config) -> tuple[np.ndarray, ...]:
    ids, n_types = np.asarray(sequences), config.scene.n_types
    return *pair_of(ids, n_types), policy_of(policy, ids, number, n_types)


def _attempts(which: tuple[Array, ...], places: Places, estimate, key) -> Attempt:
    peg_type, hole_type, kind = map(jnp.asarray, which)
    return Attempt(peg_type, hole_type, places.hole_pos_world, estimate, kind, key, places.physics)
