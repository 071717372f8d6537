"""The robot's side: simulated attempts, sent sample by sample with jitter and dropouts.

    python experiments/online/robot.py [--port P] [--peg NAME] [--attempts N] [--speed X] [--seed K]

Samples leave at their times, late by up to ``--jitter``, and out of order then; ``--lost`` of them never
leave. An attempt ends where the tracker's advice is to stop or to try another hole, else after 10 s. Advice
to search elsewhere is printed: what was simulated beforehand cannot follow it.
"""

import argparse
import json
import queue
import socket
import threading
import time
from dataclasses import replace
from typing import Any

import jax
import numpy as np

import mjx_fit as mf
from mjx_fit.task.attempt_samples import REST_S

POSE_S = 0.02
HOLES = np.array([[0.42, -0.12], [0.45, 0.0], [0.42, 0.12]])


class Robot:
    """A robot in front of three holes of different types, detected with errors."""

    def __init__(self, args: argparse.Namespace, connection: socket.socket):
        self.args, self.rng = args, np.random.default_rng(args.seed)
        self.connection: socket.socket = connection
        self.answers: queue.SimpleQueue[list[Any]] = queue.SimpleQueue()
        threading.Thread(target=self.listen, daemon=True).start()
        self.config = mf.Config()
        self.engine = mf.make_engine("native", self.config)
        self.detected = HOLES + self.rng.normal(0, 0.003, HOLES.shape)
        self.now = 1.0

    def listen(self) -> None:
        for line in self.connection.makefile():
            self.answers.put(json.loads(line))

    def say(self, *message: Any) -> None:
        self.connection.sendall(json.dumps(message).encode() + b"\n")

    def ask(self, *message: Any) -> list[Any]:
        """Send a message, and wait for its answer."""
        self.say(*message)
        while True:
            answer = self.answers.get(timeout=120)
            if answer[0] != "told":
                return answer

    def attempt(self, hole: int, estimate: list[float]) -> mf.Rollout:
        """Simulate an attempt at a hole from where the tracker says."""
        names = self.config.scene.names
        drawn = mf.draw_attempts(jax.random.key(int(self.rng.integers(2**31))), 1, config=self.config)
        there = replace(
            drawn,
            peg_type=np.array([names.index(self.args.peg)], np.int32),
            hole_type=np.array([hole % len(names)], np.int32),
            hole_pos_world=np.array([HOLES[hole]], np.float32),
            estimate_world=np.array([estimate], np.float32),
        )
        rollout = self.engine.run(there)
        return jax.tree.map(lambda leaf: np.asarray(leaf)[0], rollout)

    def messages(self, felt: mf.Felt) -> list[tuple[float, list[Any]]]:
        """Return the samples of an attempt with the times at which they leave, in order of these."""
        log = mf.log_from_felt(felt, start_s=self.now + REST_S)
        assert log.tip_linvel_world is not None
        assert log.tip_angvel_world is not None
        rest = self.now + 0.002 * np.arange(round(REST_S / 0.002))
        found = [["wrench", at, np.asarray(felt.tare_sensor).tolist()] for at in rest]
        found += [["wrench", *one] for one in zip(log.wrench_time_s, log.wrench_sensor.tolist(), strict=True)]
        measured = (log.tip_pos_world, log.tip_quat_world, log.tip_linvel_world, log.tip_angvel_world)
        often = np.arange(log.pose_time_s[0], log.pose_time_s[-1] + POSE_S / 2, POSE_S)
        rows = np.column_stack([np.interp(often, log.pose_time_s, one) for one in np.hstack(measured).T])
        rows[:, 3:7] /= np.linalg.norm(rows[:, 3:7], axis=1, keepdims=True)
        values = (rows[:, :3].tolist(), rows[:, 3:7].tolist(), rows[:, 7:].tolist())
        found += [["pose", *one] for one in zip(often.tolist(), *values, strict=True)]
        kept = [one for one in found if self.rng.random() >= self.args.lost]
        late = self.rng.exponential(self.args.jitter / 4, len(kept)).clip(0, self.args.jitter)
        timed = [(one[1] + by, one) for one, by in zip(kept, late, strict=True)]
        timed += [
            (at - 1e-6, ["command", at, step.tolist()])
            for at, step in zip(log.command_time_s, log.command_world, strict=True)
        ]
        self.now = float(log.pose_time_s[-1]) + 1.0
        return sorted(timed, key=lambda one: one[0])

    def send(self, felt: mf.Felt) -> dict[str, Any] | None:
        """Send an attempt's samples at their times, and return what was told last.

        It ends where the advice says so.
        """
        told, messages = None, self.messages(felt)
        first, begun = messages[0][0], time.perf_counter()
        for leaves, message in messages:
            wait = (leaves - first) / self.args.speed - (time.perf_counter() - begun)
            if wait > 0.001:
                time.sleep(wait)
            self.say(*message)
            while not self.answers.empty():
                told, over = self.heard(told)
                if over:
                    return told
        try:
            while told is None or told["actions"] < int(felt.length):  # the last answers are on their way
                told, over = self.heard(told)
                if over:
                    break
        except queue.Empty:
            pass  # the last samples of an action are lost
        return told

    def heard(self, told: dict[str, Any] | None) -> tuple[dict[str, Any] | None, bool]:
        """Wait for an answer, and return what was told last, and whether the attempt is over."""
        what, answer = self.answers.get(timeout=1)
        if what == "problem":
            print(f"  problem: {answer}")
            return told, True
        advice, why = answer["advice"][:2]
        if advice != "go on":
            print(f"  after {answer['actions']} actions: {advice}: {why}")
        return answer, advice in ("stop", "next hole")


def main(args: argparse.Namespace) -> None:
    with socket.create_connection(("127.0.0.1", args.port)) as connection:
        robot = Robot(args, connection)
        what, seconds = robot.ask("detections", robot.detected.tolist())
        print(f"{what} after {seconds:.1f} s")
        _, hole, estimate = robot.ask("peg", args.peg)
        for _ in range(args.attempts):
            print(f"attempt at hole {hole}, {1000 * np.linalg.norm(estimate - HOLES[hole]):.1f} mm off")
            rollout = robot.attempt(hole, estimate)
            told = robot.send(rollout.felt)
            if told is not None:
                off = 1000 * np.linalg.norm(np.array(told["place"]) - HOLES[hole])
                likely = max(told["types"], key=told["types"].get)
                print(f"  believed {off:.1f} mm off, a {likely}, {told['ms']:.0f} ms after the last sample")
            whole = told is not None and told["actions"] == int(rollout.felt.length)
            what, hole, *rest = robot.ask("inserted" if rollout.truth.inserted and whole else "failed")
            if what == "filled":
                print(f"hole {hole} is filled")
                return
            estimate, *problems = rest
            for problem in problems:
                print(f"  nothing is learnt: {problem}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--port", type=int, default=5150, help="port of the tracker (default 5150)")
    parser.add_argument("--peg", default="cross", help="the peg in hand (default cross)")
    parser.add_argument("--attempts", type=int, default=6, help="most attempts (default 6)")
    parser.add_argument("--speed", type=float, default=1.0, help="times real time (default 1)")
    parser.add_argument(
        "--jitter", type=float, default=0.01, help="largest delay of a sample, s (default 0.01)"
    )
    parser.add_argument(
        "--lost", type=float, default=0.01, help="share of samples that are lost (default 0.01)"
    )
    parser.add_argument("--seed", type=int, default=0)
    mf.configure()
    main(parser.parse_args())
