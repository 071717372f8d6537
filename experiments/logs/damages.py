"""Ways in which logs are damaged: each changes a table in place, and says by how much."""

from collections.abc import Callable
from typing import Any

import numpy as np
from robot_logs import COMMAND, FORCE, PLACE, QUAT, TORQUE, Recorded, table_of
from scipy.spatial.transform import Rotation

Rows = Any
"""A table of pandas, whose own types are too wide to be of use."""
Damage = Callable[[Rows, Recorded, np.random.Generator], str]
"""Changes a table in place, and says by how much."""


def gap(rows: Rows, own: Recorded, rng: np.random.Generator) -> str:
    begin, length = at(own, rng), rng.uniform(0.01, 0.4)
    lost = rows["fx"].notna() & rows["time"].between(begin, begin + length)
    rows.drop(index=rows.index[lost], inplace=True)
    return f"{1000 * length:.0f} ms"


def jitter(rows: Rows, own: Recorded, rng: np.random.Generator) -> str:
    most = rng.uniform(0.001, 0.02)
    felt = rows["fx"].notna()
    rows.loc[felt, "time"] += rng.uniform(0, most, felt.sum())
    return f"{1000 * most:.0f} ms"


def duplicates(rows: Rows, own: Recorded, rng: np.random.Generator) -> str:
    share = rng.uniform(0.01, 0.2)
    again = rows.loc[rng.random(len(rows)) < share]
    rows.loc[:, :] = rows  # the same rows come again at the end of the file
    for k, row in enumerate(again.to_numpy()):
        rows.loc[len(rows) + k] = row
    rows.sort_values("time", inplace=True, kind="stable")
    return f"{100 * share:.0f} %"


def not_finite(rows: Rows, own: Recorded, rng: np.random.Generator) -> str:
    share = rng.uniform(0.001, 0.1)
    felt = rows.index[rows["fx"].notna()]
    rows.loc[felt[rng.random(len(felt)) < share], rng.choice(FORCE + TORQUE)] = np.inf
    return f"{100 * share:.1f} %"


def clock(rows: Rows, own: Recorded, rng: np.random.Generator) -> str:
    jump = rng.choice([-1, 1]) * 10 ** rng.uniform(-2, 1)
    rows.loc[rows["time"] > at(own, rng), "time"] += jump
    return f"{jump:.3f} s"


def rate(rows: Rows, own: Recorded, rng: np.random.Generator) -> str:
    hertz = 10 ** rng.uniform(1.7, 3)
    times, felt = own.wrench[:, 0], rows["fx"].notna()
    new = np.arange(times[0], times[-1], 1 / hertz)
    values = np.column_stack([np.interp(new, times, column) for column in own.wrench[:, 1:].T])
    slow = Recorded(np.column_stack([new, values]), own.pose, own.command, own.attempts)
    replace_rows(rows, table_of(slow), felt)
    return f"{hertz:.0f} Hz"


def units(rows: Rows, own: Recorded, rng: np.random.Generator) -> str:
    names, factor, word = [
        (PLACE, 1000, "positions in mm"),
        (TORQUE, 1000, "torques in N mm"),
        (TORQUE, 8.85, "torques in lbf in"),
        (FORCE, 0.2248, "forces in lbf"),
        (COMMAND, 1000, "commands in mm"),
    ][rng.integers(5)]
    rows[names] *= factor
    return word


def flipped(rows: Rows, own: Recorded, rng: np.random.Generator) -> str:
    name = rng.choice([*FORCE, *TORQUE, "x", "y"])
    rows[name] *= -1
    if name == "x":
        rows["x"] += 1.0  # stays in the workspace
    return str(name)


def frame(rows: Rows, own: Recorded, rng: np.random.Generator) -> str:
    axis, angle = rng.choice(["x", "y", "z"]), rng.choice([-90, 90, 180, 45, 20])
    turn, felt = Rotation.from_euler(axis, angle, degrees=True), rows["fx"].notna()
    for names in (FORCE, TORQUE):
        rows.loc[felt, names] = turn.apply(np.array(rows.loc[felt, names]))
    return f"the sensor by {angle}° about {axis}"


def order(rows: Rows, own: Recorded, rng: np.random.Generator) -> str:
    names = [FORCE, TORQUE, PLACE, QUAT][rng.integers(4)]
    shuffled = list(names)
    while shuffled == list(names):
        rng.shuffle(shuffled)
    rows[names] = rows[shuffled].to_numpy()
    return " ".join(shuffled)


def late(rows: Rows, own: Recorded, rng: np.random.Generator) -> str:
    by = rng.uniform(0.005, 0.3)
    rows.loc[rows["fx"].notna(), "time"] += by
    rows.sort_values("time", inplace=True, kind="stable")
    return f"wrenches {1000 * by:.0f} ms"


def truncated(rows: Rows, own: Recorded, rng: np.random.Generator) -> str:
    rows.drop(index=rows.index[rows["time"] > at(own, rng)], inplace=True)
    return "rest of the file"


DAMAGES: tuple[Damage, ...] = (
    gap, jitter, duplicates, not_finite, clock, rate, units, flipped, frame, order, late, truncated,
)  # fmt: skip


def at(own: Recorded, rng: np.random.Generator) -> float:
    """Return a time in one of the attempts."""
    begin, end = own.attempts[rng.integers(len(own.attempts))]
    return float(rng.uniform(begin + 0.5, end))


def replace_rows(rows: Rows, new: Rows, _: Any) -> None:
    rows.drop(index=rows.index, inplace=True)
    for name in rows.columns:
        rows[name] = new[name]
