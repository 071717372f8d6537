"""The tracker's side: it reads samples from a local socket, and answers with beliefs and advice.

    python experiments/online/tracker.py [--port P] [--sensor RUN]

Messages are lines of JSON, a list whose first item says what it is:

    to the tracker    ["detections", [[x, y], ...]]   ["peg", NAME]      ["failed"]   ["inserted"]
                      ["pose", s, [3], [4], [6]]      ["wrench", s, [6]]   ["command", s, [3]]
    from the tracker  ["ready", s]   ["hole", index, [x, y], (problem)]   ["told", {...}]   ["problem", text]
"""

import argparse
import json
import socketserver
import time
from typing import Any

import numpy as np

import mjx_fit as mf


class Session:
    """Beliefs of one robot."""

    def __init__(self, sensor: mf.TrainedSensor, detections: list[list[float]]):
        self.tracker = mf.BeliefTracker(sensor, np.array(detections))
        self.online = mf.OnlineTracker(self.tracker)
        self.hole, self.read = 0, 0

    def next_hole(self) -> list[Any]:
        self.hole = self.tracker.choose(self.peg)
        self.online.begin(self.hole)
        self.read = 0
        return ["hole", self.hole, self.tracker.estimate(self.hole).tolist()]

    def take(self, what: str, *values: Any) -> list[Any] | None:
        """Take a message, and return the answer, if it has one."""
        match what:
            case "wrench" | "pose":
                add = self.online.add_wrench if what == "wrench" else self.online.add_pose
                add(values[0], *map(np.array, values[1:]))
                return self.told()
            case "command":
                self.online.add_command(values[0], np.array(values[1]))
                return None
            case "peg":
                (self.peg,) = values
                return self.next_hole()
            case "failed":
                return self.after_failure()
            case "inserted":
                return self.after_insertion()
        raise mf.RequestError(f"{what}: no such message")

    def after_insertion(self) -> list[Any]:
        """Keep the peg in a hole of its own type, else go on."""
        if not self.online.judge_insertion():
            return self.next_hole()
        self.tracker.fill(self.hole)
        return ["filled", self.hole]

    def after_failure(self) -> list[Any]:
        """Learn from the whole attempt; one of which samples are missing teaches nothing."""
        try:
            self.online.end()
        except mf.RequestError as error:
            return [*self.next_hole(), str(error)]
        return self.next_hole()

    def told(self) -> list[Any] | None:
        """Return belief and advice once an action is complete."""
        if self.online.samples.actions == self.read:
            return None
        self.read = self.online.samples.actions
        begun = time.perf_counter()
        advice, belief = self.online.advise(), self.online.belief()
        types = dict(zip(self.tracker.config.scene.names, np.exp(belief.type_logp).tolist(), strict=True))
        return [
            "told",
            {
                "actions": self.read,
                "place": belief.pos_mean_world.tolist(),
                "std_m": np.sqrt(np.diagonal(belief.pos_cov)).tolist(),
                "types": types,
                "advice": [advice.what, advice.why, advice.place_world, advice.hole],
                "ms": 1000 * (time.perf_counter() - begun),
                "left_out": self.online.samples.left_out,
            },
        ]


class Handler(socketserver.StreamRequestHandler):
    """One connection."""

    def handle(self) -> None:
        assert isinstance(self.server, Server)
        session: Session | None = None
        for line in self.rfile:
            what, *values = json.loads(line)
            try:
                if what == "detections":
                    begun = time.perf_counter()
                    session = Session(self.server.sensor, *values)
                    answer = ["ready", time.perf_counter() - begun]
                else:
                    assert session is not None
                    answer = session.take(what, *values)
            except mf.RequestError as error:
                answer = ["problem", str(error)]
            if answer is not None:
                self.wfile.write(json.dumps(answer).encode() + b"\n")


class Server(socketserver.TCPServer):
    """Server with a sensor."""

    allow_reuse_address = True
    sensor: mf.TrainedSensor


def main(port: int, run: str | None) -> None:
    with Server(("127.0.0.1", port), Handler) as server:
        server.sensor = mf.load_sensor(run)
        print(f"listening on port {server.server_address[1]}", flush=True)
        server.handle_request()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--port", type=int, default=5150, help="0: any that is free (default 5150)")
    parser.add_argument("--sensor", metavar="RUN", help="run of a sensor (default: the one that ships)")
    args = parser.parse_args()
    mf.configure()
    main(args.port, args.sensor)
