"""Validate the requests to an engine on the host, once per batch, before the simulation."""

import operator
from dataclasses import fields
from typing import Any, NoReturn

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from mjx_fit.config.randomized import allowed_range
from mjx_fit.config.schema import Config
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.control.policies import NAMES
from mjx_fit.filters.belief_check import require_beliefs
from mjx_fit.filters.contact_memory import require_memory
from mjx_fit.scene.robot import ROBOTS
from mjx_fit.scene.variation import GEOMETRY, require_linear
from mjx_fit.types import Attempt
from mjx_fit.types.physics import Physics, drawn
from mjx_fit.utils import memory
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.rates import ACTION_BYTES

MOST_ACTIONS = 10_000
"""Maximum number of actions in one attempt, and maximum horizon of a policy."""

MOST_THREADS = 4096

_KEYS = "threefry2x32"
MOST_OFF = {"z": (0.05, "m"), "yaw": (1.2, "rad"), "roll": (0.5, "rad"), "pitch": (0.5, "rad")}
"""Largest values of the other coordinates of an estimate: about twice those of a socket (``placement``)."""
ANY_POLICY = 2**31
"""Bound of ``attempts.policy`` for a custom policy, which may interpret the value freely."""


def require_attempts(
    attempts: Attempt,
    actions: int,
    horizon: int | None,
    active: Bool[np.ndarray, "n"] | None,
    config: Config,
    policies: int = len(NAMES),
) -> tuple[int, int, Bool[np.ndarray, "n"]]:
    """Check that an engine can run these attempts.

    Args:
        attempts: Batch (n,); only active rows need valid values.
        actions: Maximum number of actions in one attempt.
        horizon: Number of actions that a policy plans for; None: ``actions``.
        active: Whether to run each attempt; None: all.
        config: Defines the shapes, the reach of the robot, and the coordinates of estimates.
        policies: Number of policies that ``attempts.policy`` indexes.

    Returns:
        The number of actions, the horizon, and the active rows.

    Raises:
        RequestError: A field has an invalid type, shape or value; the message names it.
    """
    n = _length(attempts)
    actions = require_count("actions", actions, 1, MOST_ACTIONS)
    memory.require(n * actions * ACTION_BYTES, f"attempts: {n:,} of {actions:,} actions", "run fewer at once")
    horizon = actions if horizon is None else require_count("horizon", horizon, actions, MOST_ACTIONS)
    active = np.ones(n, bool) if active is None else np.asarray(active)
    if active.dtype != bool or active.shape != (n,):
        _refuse("active", f"{active.dtype} {active.shape}", f"expected bool ({n},), one for each attempt")
    scene, d = config.scene, len(config.filter.coordinates)
    counts = {"peg_type": scene.n_types, "hole_type": scene.n_types, "policy": policies}
    for name, count in counts.items():
        _require_indices(name, _leaf(attempts, name, n, (), jnp.integer, "integers"), active, count)
    robot = ROBOTS[scene.robot]
    places = {"hole_pos_world": (robot.hole_reach_m, 2), "estimate_world": (robot.estimate_reach_m, d)}
    for name, (reach, width) in places.items():
        leaf = _leaf(attempts, name, n, (width,), jnp.floating, "floats")
        _require_places(name, leaf, active, reach)
    _require_small(attempts.estimate_world, active, config.filter.coordinates)
    if attempts.belief is not None:
        require_beliefs(attempts.belief, n, scene.n_types, active, d)
        require_memory(attempts.belief, config)
    if attempts.elsewhere_per_s is not None:
        _require_finite("elsewhere_per_s", attempts.elsewhere_per_s, (n,), active)
    _require_keys(attempts.key, n)
    _require_physics(attempts.physics, n, active, scene)
    return actions, horizon, active


def require_count(name: str, value: Any, least: int, most: int) -> int:
    """Return a value as a whole number after a range check.

    Raises:
        RequestError: The value is no whole number, or out of range.
    """
    try:
        number = operator.index(value)
    except TypeError:
        number = None
    if number is None or isinstance(value, bool) or not least <= number <= most:
        _refuse(name, repr(value), f"expected a whole number from {least} to {most}")
    return number


def _length(attempts: Attempt) -> int:
    if not isinstance(attempts, Attempt):
        _refuse("attempts", type(attempts).__name__, "expected an Attempt")
    leaves = {field.name: getattr(attempts, field.name) for field in fields(Attempt)}
    physics, belief = leaves.pop("physics"), leaves.pop("belief")
    if leaves["elsewhere_per_s"] is None:
        del leaves["elsewhere_per_s"]
    if belief is not None:
        leaves |= {name: leaf for name, leaf in vars(belief).items() if name != "memory"}
    if not isinstance(physics, Physics):
        _refuse("attempts: physics", type(physics).__name__, "expected Physics")
    for name, leaf in (leaves | drawn(physics)).items():
        if not hasattr(leaf, "shape"):
            _refuse(f"attempts: {name}", type(leaf).__name__, "expected a NumPy or JAX array")
    shape = np.shape(attempts.peg_type)
    if len(shape) != 1 or not shape[0]:
        _refuse("attempts: peg_type", f"shape {shape}", "expected (n,) with n >= 1")
    return shape[0]


def _leaf(attempts: Attempt, name: str, n: int, rest: tuple[int, ...], kind: Any, word: str) -> np.ndarray:
    leaf = getattr(attempts, name)
    if leaf.shape != (n, *rest) or not jnp.issubdtype(leaf.dtype, kind):
        _refuse(f"attempts: {name}", f"{leaf.dtype} {leaf.shape}", f"expected {word} {(n, *rest)}")
    return np.asarray(leaf)


def _require_indices(name: str, leaf: np.ndarray, active: np.ndarray, count: int) -> None:
    wrong = active & ((leaf < 0) | (leaf >= count))
    if wrong.any():
        row = int(wrong.argmax())
        _refuse(f"attempts: {name} of row {row}", str(leaf[row]), f"expected 0 to {count - 1}")


def _require_places(name: str, leaf: np.ndarray, active: np.ndarray, reach: tuple[float, float]) -> None:
    with np.errstate(all="ignore"):
        distance = np.hypot(leaf[:, 0], leaf[:, 1])
        wrong = active & ~((reach[0] <= distance) & (distance <= reach[1]) & (leaf[:, 0] > 0))
    if wrong.any():
        row = int(wrong.argmax())
        x, y = leaf[row, :2].tolist()
        _refuse(
            f"attempts: {name} of row {row}",
            f"({x:.6g}, {y:.6g}) m",
            f"expected {reach[0]} to {reach[1]} m from the arm's base, with x positive",
        )


def _require_small(estimate: Any, active: np.ndarray, coordinates: tuple[str, ...]) -> None:
    """Check the height and the rotations of estimates: the robot reaches what a socket may have, and more."""
    for i, coordinate in enumerate(coordinates[2:], 2):
        value, (most, unit) = np.asarray(estimate)[:, i], MOST_OFF[coordinate]
        wrong = active & ~(np.abs(value) <= most)
        if wrong.any():
            row = int(wrong.argmax())
            _refuse(
                f"attempts: estimate_world of row {row}: {coordinate}",
                f"{value[row]:.6g} {unit}",
                f"expected -{most} to {most}",
            )


def _require_finite(name: str, leaf: Any, shape: tuple[int, ...], active: np.ndarray) -> None:
    if leaf.shape != shape or not jnp.issubdtype(leaf.dtype, jnp.floating):
        _refuse(f"attempts: {name}", f"{leaf.dtype} {leaf.shape}", f"expected floats {shape}")
    wrong = active & ~np.isfinite(np.asarray(leaf)).reshape(len(active), -1).all(1)
    if wrong.any():
        row = int(wrong.argmax())
        found = str(np.asarray(leaf)[row].tolist())
        _refuse(f"attempts: {name} of row {row}", found, "expected finite numbers")


def _require_physics(physics: Physics, n: int, active: np.ndarray, scene: SceneConfig) -> None:
    ranges = {}
    for name, leaf in drawn(physics).items():
        if leaf.shape != (n,) or not jnp.issubdtype(leaf.dtype, jnp.floating):
            _refuse(f"attempts: physics.{name}", f"{leaf.dtype} {leaf.shape}", f"expected floats ({n},)")
        least, most = allowed_range(name)
        wrong = active & ~((np.float32(least) <= np.asarray(leaf)) & (np.asarray(leaf) <= np.float32(most)))
        if wrong.any():
            row = int(wrong.argmax())
            _refuse(
                f"attempts: physics.{name} of row {row}", f"{leaf[row]:.6g}", f"expected {least} to {most}"
            )
        if name in GEOMETRY and active.any():
            own = np.asarray(leaf, float)[active]
            ranges[name] = (own.min(), own.max())
    require_linear(scene, ranges, "attempts: physics")


def _require_keys(key: Any, n: int) -> None:
    if not jnp.issubdtype(key.dtype, jax.dtypes.prng_key):
        _refuse("attempts: key", str(key.dtype), "expected keys from jax.random.key")
    if key.shape != (n,):
        _refuse("attempts: key", f"shape {key.shape}", f"expected ({n},), one for each attempt")
    if str(jax.random.key_impl(key)) != _KEYS:
        _refuse("attempts: key", str(jax.random.key_impl(key)), f"expected the implementation {_KEYS}")


def _refuse(name: str, value: str, allowed: str) -> NoReturn:
    raise RequestError(f"{name}: {value} is invalid: {allowed}")
