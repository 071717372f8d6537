"""Frames of a LeRobot data set: the features, and their values in an attempt."""

from typing import Any

import numpy as np

from mjx_fit.config.schema import Config
from mjx_fit.data.exports.recording import Recording
from mjx_fit.utils.rates import ACTION_S, SUBSTEPS

Frames = dict[str, np.ndarray[Any, Any]]
"""Values of features, with a row for each frame."""

POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
COMMAND, TURN = ("dx", "dy", "dz"), ("rx", "ry", "rz")
STATE, WINDOW, ESTIMATE, ACTION, PEG = (
    "observation.state",
    "observation.wrench",
    "observation.estimate",
    "action",
    "peg",
)
HOLE, PLACE, SUCCESS = "truth.hole", "truth.place", "next.success"


def features_of(config: Config, turns: bool, known: bool) -> dict[str, dict[str, Any]]:
    """Return LeRobot's descriptions of the features.

    Args:
        config: Configuration of the data set.
        turns: Whether commands turn the TCP.
        known: Whether it is known which hole it was, where, and which attempts inserted the peg.
    """
    action = (*COMMAND, *TURN) if turns else COMMAND
    found = {
        STATE: _feature("float32", (len(POSE + TWIST),), [*POSE, *TWIST]),
        WINDOW: _feature("float32", (SUBSTEPS, len(WRENCH)), {"axes": list(WRENCH)}),
        ESTIMATE: _feature(
            "float32",
            (len(config.filter.coordinates),),
            [f"hole_{name}" for name in config.filter.coordinates],
        ),
        ACTION: _feature("float32", (len(action),), list(action)),
        PEG: _feature("string", (1,), None),
        "next.done": _feature("bool", (1,), None),
    }
    if known:
        found[HOLE] = _feature("string", (1,), None)
        found[PLACE] = _feature("float32", (2,), ["x", "y"])
        found[SUCCESS] = _feature("bool", (1,), None)
        found["next.reward"] = _feature("float32", (1,), None)
    return found | {
        "timestamp": _feature("float32", (1,), None),
        **{
            name: _feature("int64", (1,), None)
            for name in ("frame_index", "episode_index", "index", "task_index")
        },
    }


def _feature(dtype: str, shape: tuple[int, ...], names: Any) -> dict[str, Any]:
    return {"dtype": dtype, "shape": list(shape), "names": names}


def frames_of(one: Recording) -> Frames:
    """Return the frames of an attempt, one more than actions, without the indices."""
    log = one.log
    assert log.tip_linvel_world is not None
    assert log.tip_angvel_world is not None
    n = len(log.command_time_s)
    tare = np.tile(np.asarray(log.tare_sensor), (1, SUBSTEPS, 1))
    commands = [log.command_world] if one.turn_world is None else [log.command_world, one.turn_world]
    last = np.arange(n + 1) >= n - 1
    found: Frames = {
        STATE: np.column_stack(
            [log.tip_pos_world, log.tip_quat_world, log.tip_linvel_world, log.tip_angvel_world]
        ),
        WINDOW: np.concatenate([tare, log.wrench_sensor.reshape(n, SUBSTEPS, -1)]),
        ESTIMATE: np.tile(one.estimate, (n + 1, 1)),
        ACTION: np.pad(np.concatenate(commands, -1), ((0, 1), (0, 0))),
        PEG: np.full(n + 1, one.peg),
        "next.done": last,
        "timestamp": (ACTION_S * np.arange(n + 1)).astype(np.float32),
        "frame_index": np.arange(n + 1),
    }
    if one.truth is not None:
        assert one.place_world is not None
        found[HOLE] = np.full(n + 1, one.hole)
        found[PLACE] = np.tile(one.place_world, (n + 1, 1))
        found[SUCCESS] = last & bool(one.truth.inserted)
        found["next.reward"] = found[SUCCESS].astype(np.float32)
    return found
