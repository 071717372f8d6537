"""Child processes of a command, which do not outlive it."""

import multiprocessing
import os
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor

from mjx_fit.utils import environment, interrupts

PATIENCE_S = 3.0
"""Time for a child to shut down cleanly when its parent stops, s."""


def run(words: list[str]) -> int:
    """Run ``mjx-fit`` with these arguments, in the user's original environment.

    The child ends when this process ends, for whatever reason.

    Returns:
        Exit code of the child.
    """
    own = environment.for_children() | {interrupts.PARENT: str(os.getpid())}
    child = subprocess.Popen([sys.executable, "-m", "mjx_fit", *words], env=own)
    try:
        return child.wait()
    except BaseException:
        child.terminate()
        try:
            child.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            child.kill()
        raise


def worker() -> ProcessPoolExecutor:
    """Create a pool of one new process, for isolated measurements; this process handles Ctrl-C."""
    spawn = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(1, mp_context=spawn, initializer=interrupts.serve, initargs=(os.getpid(),))
