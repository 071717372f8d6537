"""What a command runs in processes of their own, which do not outlive it."""

import multiprocessing
import os
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor

from mjx_fit.utils import environment, interrupts

PATIENCE_S = 3.0
"""Time that a child has to stop in order when its parent stops, s."""


def run(words: list[str]) -> int:
    """Runs ``mjx-fit`` with these words, in the environment as the user set it.

    However this process ends, the child ends, too.

    Returns:
        Its exit code.
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
    """A pool of one new process, for what is measured alone. Ctrl-C is left to this one."""
    spawn = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(1, mp_context=spawn, initializer=interrupts.serve, initargs=(os.getpid(),))
