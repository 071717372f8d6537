"""What an engine can be asked: checked on the host, once for each batch, before anything is simulated."""

import operator
from dataclasses import fields
from typing import Any, NoReturn

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from mjx_fit.config.sections.world import SceneConfig
from mjx_fit.control.policies import NAMES
from mjx_fit.scene.robot import ROBOTS
from mjx_fit.types import ACTION_BYTES, Attempt
from mjx_fit.utils import memory
from mjx_fit.utils.errors import RequestError

MOST_ACTIONS = 10_000
"""Actions in one attempt, and those that a policy plans for, at most."""

MOST_THREADS = 4096

_KEYS = "threefry2x32"
ANY_POLICY = 2**31
"""What ``attempts.policy`` means to a policy of one's own is its own affair."""


def require_attempts(
    attempts: Attempt,
    actions: int,
    horizon: int | None,
    active: Bool[np.ndarray, "n"] | None,
    scene: SceneConfig,
    policies: int = len(NAMES),
) -> tuple[int, int, Bool[np.ndarray, "n"]]:
    """Makes sure that an engine can run these attempts.

    Args:
        attempts: A batch (n,); values count where they are active.
        actions: Most actions in one attempt.
        horizon: Actions that a policy plans for; None: as many.
        active: Which of them to run; None: all.
        scene: Says which shapes there are, and where its robot can reach.
        policies: How many there are to choose from by ``attempts.policy``.

    Returns:
        The actions, the horizon, and which are to be run.

    Raises:
        RequestError: A field has another type, shape or value than is allowed; the message names it.
    """
    n = _length(attempts)
    actions = require_count("actions", actions, 1, MOST_ACTIONS)
    memory.require(n * actions * ACTION_BYTES, f"attempts: {n:,} of {actions:,} actions", "run fewer at once")
    horizon = actions if horizon is None else require_count("horizon", horizon, actions, MOST_ACTIONS)
    active = np.ones(n, bool) if active is None else np.asarray(active)
    if active.dtype != bool or active.shape != (n,):
        _refuse("active", f"{active.dtype} {active.shape}", f"expected bool ({n},), one for each attempt")
    counts = {"peg_type": scene.n_types, "hole_type": scene.n_types, "policy": policies}
    for name, count in counts.items():
        _require_indices(name, _leaf(attempts, name, n, (), jnp.integer, "integers"), active, count)
    robot = ROBOTS[scene.robot]
    places = {"hole_pos_world": robot.hole_reach_m, "estimate_world": robot.estimate_reach_m}
    for name, reach in places.items():
        _require_places(name, _leaf(attempts, name, n, (2,), jnp.floating, "floats"), active, reach)
    _require_keys(attempts.key, n)
    return actions, horizon, active


def require_count(name: str, value: Any, least: int, most: int) -> int:
    """A whole number within bounds.

    Raises:
        RequestError: It is not one, or out of bounds.
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
    for field in fields(Attempt):
        if not hasattr(getattr(attempts, field.name), "shape"):
            given = type(getattr(attempts, field.name)).__name__
            _refuse(f"attempts: {field.name}", given, "expected a NumPy or JAX array")
    shape = np.shape(attempts.peg_type)
    if len(shape) != 1 or not shape[0]:
        _refuse("attempts: peg_type", f"shape {shape}", "expected (n,) with n of 1 or more")
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
        x, y = leaf[row].tolist()
        _refuse(
            f"attempts: {name} of row {row}",
            f"({x:.6g}, {y:.6g}) m",
            f"expected {reach[0]} to {reach[1]} m from the arm's base, with x positive",
        )


def _require_keys(key: Any, n: int) -> None:
    if not jnp.issubdtype(key.dtype, jax.dtypes.prng_key):
        _refuse("attempts: key", str(key.dtype), "expected keys as jax.random.key makes them")
    if key.shape != (n,):
        _refuse("attempts: key", f"shape {key.shape}", f"expected ({n},), one for each attempt")
    if str(jax.random.key_impl(key)) != _KEYS:
        _refuse("attempts: key", str(jax.random.key_impl(key)), f"expected the implementation {_KEYS}")


def _refuse(name: str, value: str, allowed: str) -> NoReturn:
    raise RequestError(f"{name}: {value} is invalid: {allowed}")
