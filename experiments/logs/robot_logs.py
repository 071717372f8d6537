"""Logs as a robot would write them, made from simulated attempts, with free motion before and after each."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas
from scipy.spatial.transform import Rotation, Slerp

from mjx_fit.types import Felt
from mjx_fit.utils.rates import ACTION_S, STEP_S

REST_S = 1.2
POSE_S = 0.01


@dataclass(frozen=True)
class Recorded:
    """Samples in the library's frames and signs.

    Attributes:
        wrench: Time, then wrench on the peg in the sensor's frame, (N, 7).
        pose: Time, position, and quaternion w x y z, (M, 8).
        command: Time and displacement (J, 4).
        attempts: Begin and end of each attempt, s.
    """

    wrench: np.ndarray
    pose: np.ndarray
    command: np.ndarray
    attempts: tuple[tuple[float, float], ...]


def recorded(attempts: list[Felt], start_s: float = 100.0, noise_n: float = 0.0, seed: int = 0) -> Recorded:
    """String attempts together: the arm rests in free space before each, and moves up and away after it."""
    wrench, pose, command, spans, now = [], [], [], [], start_s
    for felt in attempts:
        n = int(felt.length)
        begin = now + REST_S
        tare = np.asarray(felt.tare_sensor, float)
        rest = now + STEP_S * np.arange(round(REST_S / STEP_S))
        samples = np.asarray(felt.trace.wrench_sensor, float)[:n].reshape(-1, 6)
        wrench.append(np.column_stack([rest, np.tile(tare, (len(rest), 1))]))
        wrench.append(np.column_stack([begin + STEP_S * np.arange(len(samples)), samples]))
        pose.append(_poses(felt, n, now, begin))
        steps = np.asarray(felt.trace.action_world, float)[:n]
        command.append(np.column_stack([begin + ACTION_S * np.arange(n), steps]))
        end = begin + ACTION_S * n
        spans.append((begin, end))
        after = end + STEP_S * np.arange(round(REST_S / STEP_S))
        wrench.append(np.column_stack([after, np.tile(tare, (len(after), 1))]))
        now = end + REST_S
    wrench, pose, command = (np.concatenate(one) for one in (wrench, pose, command))
    if noise_n:
        wrench[:, 1:] += np.random.default_rng(seed).normal(0, noise_n, (len(wrench), 6)) * (
            [1] * 3 + [0.02] * 3
        )
    return Recorded(wrench, pose, command, tuple(spans))


def _poses(felt: Felt, n: int, now: float, begin: float) -> np.ndarray:
    """Return poses every 10 ms: at rest above the hole, in the attempt, and back up."""
    first = felt.start
    assert first is not None
    at = np.concatenate([[np.asarray(first.pos_world)], np.asarray(felt.trace.tip_pos_world)[:n]]).astype(
        float
    )
    turn = np.concatenate([[np.asarray(first.quat_world)], np.asarray(felt.trace.tip_quat_world)[:n]])
    up = at[0] + [0, 0, 0.03]
    known = np.concatenate(
        [[now, begin], begin + ACTION_S * (1 + np.arange(n)), [begin + ACTION_S * n + REST_S]]
    )
    places = np.concatenate([at[:1], at, [up]])
    turns = Rotation.from_quat(np.concatenate([turn[:1], turn, turn[:1]]).astype(float), scalar_first=True)
    # Times of the attempt's grid are among the samples: what is read there is what was felt.
    time = now + POSE_S * np.arange(round((known[-1] - now) / POSE_S))
    where = np.column_stack([np.interp(time, known, column) for column in places.T])
    return np.column_stack([time, where, Slerp(known, turns)(time).as_quat(scalar_first=True)])


def table_of(own: Recorded) -> pandas.DataFrame:
    """Return a table with a row for each sample of each signal, in the order of their times."""
    parts = (
        (own.wrench, [*FORCE, *TORQUE]),
        (own.pose, [*PLACE, *QUAT]),
        (own.command, COMMAND),
    )
    rows = pandas.concat([pandas.DataFrame(values, columns=["time", *names]) for values, names in parts])
    return rows.sort_values("time", kind="stable").reset_index(drop=True)


FORCE, TORQUE = ["fx", "fy", "fz"], ["tx", "ty", "tz"]
PLACE, QUAT, COMMAND = ["x", "y", "z"], ["qw", "qx", "qy", "qz"], ["dx", "dy", "dz"]


def map_of_table() -> dict[str, Any]:
    """Return the map of such a table."""
    return {
        "wrench": {
            "source": [*FORCE, *TORQUE],
            "acts_on": "peg",
            "sensor_in_tool": {"position_m": [0, 0, -0.07]},
        },
        "pose": {"source": [*PLACE, *QUAT], "rotation": "quat_wxyz"},
        "command": {"source": COMMAND},
        "attempts": {"by": "contact", "peg": "cross"},
    }
