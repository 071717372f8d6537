"""Robot and tracker of ``experiments/online`` in processes of their own, over a local socket."""

import re
import subprocess
import sys

import pytest
from places import EXPERIMENTS

ONLINE = EXPERIMENTS / "online"


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("lost", ["0.01", "0.9"])
def test_a_robot_is_told_what_to_do(lost):
    """The peg goes in where one sample in a hundred is lost; the gaps are said where nine in ten are."""
    words = [sys.executable, "tracker.py", "--port", "0"]
    with subprocess.Popen(words, cwd=ONLINE, stdout=subprocess.PIPE, text=True) as tracker:
        assert tracker.stdout is not None
        found = re.search(r"port (\d+)", tracker.stdout.readline())
        assert found
        asked = ["--port", found[1], "--lost", lost, "--speed", "3", "--attempts", "3"]
        robot = subprocess.run(
            [sys.executable, "robot.py", *asked],
            cwd=ONLINE, capture_output=True, text=True, check=False, timeout=300,
        )  # fmt: skip
        assert robot.returncode == 0, robot.stderr[-2000:]
        assert tracker.wait(30) == 0
    print(robot.stdout)
    told = robot.stdout
    assert told.startswith("ready after ")
    if lost == "0.01":
        assert "hole 0 is filled" in told
    else:
        assert re.search(r"problem: .*no sample for|nothing is learnt", told)
