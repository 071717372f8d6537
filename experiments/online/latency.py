"""Latency of the online tracker, on one core, at the rates of a robot.

    taskset -c 0 python experiments/online/latency.py OUT.json [--minutes M] [--sensor RUN]

Wrenches come at 500 Hz, poses with twists at 100 Hz; a belief and an advice are asked for after each action.
Samples are added at their times in real time, so that caches are as cold as they are on a robot.
"""

import argparse
import resource
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np

import mjx_fit as mf
from mjx_fit.report import script
from mjx_fit.task.attempt_samples import REST_S

POSE_EVERY = 5
MOST = 500_000
"""Most calls that are noted."""


class Seconds:
    """Times of calls, in memory that is there from the beginning: what grows is the tracker's."""

    def __init__(self) -> None:
        self._values, self._count = np.ones(MOST), 0

    def add(self, seconds: float) -> None:
        self._values[self._count] = seconds
        self._count += 1

    def summary(self) -> dict[str, float]:
        ms = 1000 * self._values[: self._count]
        p50, p99 = np.percentile(ms, [50, 99])
        return {"n": len(ms), "p50": round(p50, 3), "p99": round(p99, 3), "max": round(ms.max(), 3)}


def main(out: Path, minutes: float, run: str | None) -> None:
    felt = failed_attempt()
    sensor = mf.load_sensor(run)
    tracker = mf.BeliefTracker(sensor, np.array([felt.estimate_world, [0.5, -0.1]]))
    begun = time.perf_counter()
    online = mf.OnlineTracker(tracker)
    start_up_s = time.perf_counter() - begun
    log = mf.log_from_felt(felt, start_s=REST_S)  # what the simulation computes is no part of the tracker
    compiled: list[str] = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, duration_secs, **_: compiled.append(event) if "backend_compile" in event else None
    )
    told = {name: Seconds() for name in ("wrench", "pose", "belief", "end")}
    memory = [resource.getrusage(resource.RUSAGE_SELF).ru_maxrss]
    end = time.perf_counter() + 60 * minutes
    while time.perf_counter() < end:
        tracker.belief = jax.tree.map(np.array, tracker._detected)
        tracker.choose(sensor.config.scene.names[int(felt.peg_type)])
        online.begin(0)
        attempt(online, np.asarray(felt.tare_sensor), log, told)
        memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    script.save(
        out,
        {
            "minutes": minutes,
            "start_up_s": start_up_s,
            "compiled_after_start_up": len(compiled),
            "memory_mib": [round(kib / 1024, 1) for kib in (memory[1], memory[len(memory) // 2], memory[-1])],
            "milliseconds": {name: seconds.summary() for name, seconds in told.items()},
        },
    )


def failed_attempt() -> mf.Felt:
    """Return an attempt of 10 s that failed."""
    drawn = mf.draw_attempts(jax.random.key(3), 2)
    rollout = mf.make_engine("native").run(drawn)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[1], rollout.felt)


def attempt(online: mf.OnlineTracker, tare: np.ndarray, log: mf.SensorLog, told: dict[str, Seconds]) -> None:
    """Send an attempt in real time, and note the seconds of each call."""
    assert log.tip_linvel_world is not None
    assert log.tip_angvel_world is not None
    wrench = np.concatenate([np.tile(tare, (round(REST_S / 0.002), 1)), log.wrench_sensor])
    poses = np.hstack([log.tip_pos_world, log.tip_quat_world, log.tip_linvel_world, log.tip_angvel_world])
    begun, actions = time.perf_counter(), 0
    for i, sample in enumerate(wrench):
        now = 0.002 * i
        time.sleep(max(0.0, now - (time.perf_counter() - begun)))
        action = round((now - REST_S) / 0.002)
        if action >= 0 and action % 50 == 0:
            online.add_command(now, log.command_world[action // 50])
        timed(told["wrench"], online.add_wrench, now, sample)
        if i % POSE_EVERY == 0:
            row = np.array([np.interp(now, log.pose_time_s, column) for column in poses.T])
            turn = row[3:7] / np.linalg.norm(row[3:7])
            timed(told["pose"], online.add_pose, now, row[:3], turn, row[7:])
        if online.samples.actions > actions:
            actions = online.samples.actions
            timed(told["belief"], online.advise)
    timed(told["end"], online.end)


def timed(into: Seconds, call: Any, *arguments: Any) -> None:
    begun = time.perf_counter()
    call(*arguments)
    into.add(time.perf_counter() - begun)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT.json")
    parser.add_argument("--minutes", type=float, default=10.0, help="time of the measurement (default 10)")
    parser.add_argument("--sensor", metavar="RUN", help="run of a sensor (default: the one that ships)")
    args = parser.parse_args()
    mf.configure()
    main(args.out, args.minutes, args.sensor)
