"""Validation of traces before a sensor reads them, applied to attempts from outside the library.

Shapes are always checked; values only outside ``jax.jit``, where arrays are concrete.
"""

from typing import Any

import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import Bool

from mjx_fit.sensors.sensor_log import MOST_OFF_UNIT
from mjx_fit.types import Felt, Reading
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.rates import SUBSTEPS

WRENCH_AXES = 6
_ROWS = {
    "wrench_sensor": (SUBSTEPS, WRENCH_AXES),
    "tip_pos_world": (3,),
    "tip_quat_world": (4,),
    "tip_linvel_world": (3,),
    "tip_angvel_world": (3,),
    "action_world": (3,),
}
_OTHERS = {"peg_type": (), "length": (), "tare_sensor": (WRENCH_AXES,), "estimate_world": None}
"""Shapes behind the batch axes; an estimate has as many coordinates as are believed."""


def require_readable(felt: Felt, n_types: int, batch: int = 1, d: int = 2) -> None:
    """Check that a sensor can read attempts.

    Only values in rows before ``length`` are checked.

    Args:
        felt: Measurements with ``batch`` leading axes.
        n_types: Number of peg shapes.
        batch: Number of batch axes, 0 or 1.
        d: Number of coordinates of estimates.

    Raises:
        RequestError: A field has the wrong shape or an invalid value; the message names it.
    """
    trace = felt.trace
    rows = np.shape(trace.wrench_sensor)[: batch + 1]
    for name, rest in _ROWS.items():
        _require_shape(f"trace.{name}", getattr(trace, name), (*rows, *rest), f"J {SUBSTEPS} {WRENCH_AXES}")
    for name, rest in _OTHERS.items():
        leaf = getattr(felt, name)
        _require_shape(name, leaf, (*rows[:-1], *((d,) if rest is None else rest)))
    if felt.start is not None:
        for name, width in (("pos_world", 3), ("quat_world", 4)):
            _require_shape(f"start.{name}", getattr(felt.start, name), (*rows[:-1], width))
    if _is_traced(felt):
        return
    one = jax.tree.map(np.asarray, felt)
    if not batch:
        one = jax.tree.map(lambda leaf: leaf[None], one)
    _require_indices("length", one.length, rows[-1])
    _require_indices("peg_type", one.peg_type, n_types - 1)
    counts = np.arange(rows[-1]) < one.length[:, None]
    for name in _ROWS:
        _require_finite(f"trace.{name}", getattr(one.trace, name), counts)
    for name in ("tare_sensor", "estimate_world"):
        _require_finite(name, getattr(one, name)[:, None], counts[:, :1])
    if one.start is not None:
        _require_finite("start.pos_world", one.start.pos_world[:, None], counts[:, :1])
        _require_unit("start.quat_world", one.start.quat_world[:, None], counts[:, :1])
    _require_unit("trace.tip_quat_world", one.trace.tip_quat_world, counts)


def require_reading(reading: Reading, n_types: int) -> None:
    """Check that a sensor can process a reading: window sizes, peg types, and finite values.

    Args:
        reading: Reading with any batch axes.
        n_types: Number of shapes known to the sensor.

    Raises:
        RequestError: A check fails; the message names the field.
    """
    rows = np.shape(reading.mask)
    _require_shape("reading.wrench_sensor", reading.wrench_sensor, (*rows, SUBSTEPS, WRENCH_AXES))
    if _is_traced(reading):
        return
    mask = np.asarray(reading.mask)
    _require_indices("reading.peg_type", np.asarray(reading.peg_type), n_types - 1)
    for name in (
        "wrench_sensor",
        "tip_pos_estimate",
        "tip_quat_world",
        "tip_linvel_world",
        "tip_angvel_world",
    ):
        _require_finite(f"reading.{name}", np.asarray(getattr(reading, name)), mask)


def _is_traced(tree: Any) -> bool:
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))


def _require_shape(name: str, leaf: Any, shape: tuple[int, ...], words: str = "") -> None:
    if np.shape(leaf) != shape:
        raise RequestError(
            f"{name}: shape {np.shape(leaf)} is invalid: expected {shape}" + f" ({words})" * bool(words)
        )


def _require_indices(name: str, leaf: np.ndarray, most: int) -> None:
    wrong = ~((leaf >= 0) & (leaf <= most))
    if wrong.any() or leaf.dtype.kind not in "iu":
        value = leaf.reshape(-1)[wrong.argmax()]
        raise RequestError(f"{name}: {value} is invalid: expected a whole number from 0 to {most}")


def _require_finite(name: str, leaf: np.ndarray, counts: Bool[np.ndarray, "*n"]) -> None:
    with np.errstate(all="ignore"):
        if np.isfinite(leaf.sum(dtype=leaf.dtype if leaf.dtype.kind == "f" else None)):
            return
    # Accept NaN in the padding, and sums that overflow.
    wrong = ~np.isfinite(leaf).reshape(*counts.shape, -1).all(-1) & counts
    if wrong.any():
        place = ", ".join(map(str, np.argwhere(wrong)[0]))
        raise RequestError(f"{name}: the value at ({place}) is invalid: expected a finite number")


def _require_unit(name: str, quaternion: np.ndarray, counts: Bool[np.ndarray, "*n"]) -> None:
    size = np.sqrt(np.square(quaternion.astype(np.float32)).sum(-1))
    wrong = ~(abs(size - 1) <= MOST_OFF_UNIT) & counts
    if wrong.any():
        at = tuple(np.argwhere(wrong)[0])
        raise RequestError(
            f"{name}: {np.round(quaternion[at], 4).tolist()} is invalid: its norm is {size[at]:.4g}, "
            f"expected 1 within {MOST_OFF_UNIT:.0%}"
        )
