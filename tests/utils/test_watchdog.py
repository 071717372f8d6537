"""The watchdog ends a command without progress, and nothing else."""

import subprocess
import sys

PROGRAM = """
import time
from mjx_fit.utils.watchdog import Watchdog
with Watchdog("work", patience_s=2) as watchdog:
    began = time.monotonic()
    while time.monotonic() - began < 5:
        {}
print("done")
"""


def run(body):
    program = PROGRAM.format(body)
    command = [sys.executable, "-c", program]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_work_that_stands_still_is_ended():
    done = run("time.sleep(30)")
    assert done.returncode == 1
    assert done.stdout == ""
    assert "work has stalled: no progress and no CPU time for 2 s" in done.stderr


def test_work_that_computes_or_speaks_is_left_alone():
    for body in ("sum(range(1000))", "time.sleep(0.2); watchdog.beat()"):
        done = run(body)
        assert done.returncode == 0, done.stderr
        assert done.stdout == "done\n"
