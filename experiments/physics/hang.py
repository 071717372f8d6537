"""Count hangs of MJX rollouts with many worlds, each run watched by another process.

    python experiments/physics/hang.py [--dispatch inline|async]

``inline`` is the mode of the mjx_fit commands: each host thread runs its part of the batch itself. ``async``
is JAX's default: one computation over the whole batch, dispatched to one of XLA's threads.
"""

import argparse
import subprocess
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import shared

from mjx_fit.config.schema import Config
from mjx_fit.data.schedule import draw_attempts
from mjx_fit.engines.mjx.engine import MjxEngine
from mjx_fit.utils import compilation_cache, process_setup

WORLDS = (256, 1024, 4096)
PROCESSES, RUNS_EACH = 10, 5
LIMIT_S = 600
"""A process without output for this long has hung; a run of 4,096 worlds takes about ten seconds."""


def main(dispatch: str) -> None:
    """Start the processes one after the other and count the runs that finished."""
    results = {}
    for worlds in WORLDS:
        seconds, hung = [], 0
        for _ in range(PROCESSES):
            done = _watched([sys.executable, __file__, "--worker", str(worlds), "--dispatch", dispatch])
            seconds += done
            hung += len(done) < RUNS_EACH
        results[str(worlds)] = {
            "runs": len(seconds) + hung,
            "hung": hung,
            "run_s": shared.quantiles(np.asarray(seconds), (0, 0.5, 1)),
        }
        print(worlds, results[str(worlds)], flush=True)
    shared.save(f"hang_{dispatch}", {"dispatch": dispatch, "processes": PROCESSES, "worlds": results})


def work(worlds: int, dispatch: str) -> None:
    """Compile once, run one action of all worlds several times, and print the duration of each run."""
    if dispatch == "inline":
        process_setup.configure()
    else:
        jax.config.update("jax_compilation_cache_dir", str(compilation_cache.CACHE / "xla"))
    config = Config()
    engine = MjxEngine(config, 2 if dispatch == "inline" else 1)
    attempts = draw_attempts(jax.random.key(0), jnp.arange(worlds), "spiral", config)
    for _ in range(RUNS_EACH):
        began = time.perf_counter()
        assert engine.run(attempts, 1).truth.valid.all()
        print(time.perf_counter() - began, flush=True)


def _watched(command: list[str]) -> list[float]:
    """Return the worker's durations, printed until it ended or stayed silent for too long."""
    log = Path("/dev/shm" if Path("/dev/shm").is_dir() else ".") / "mjx_fit_hang.log"
    with log.open("w") as out:
        process = subprocess.Popen(command, stdout=out, stderr=subprocess.DEVNULL)
    heard, since = 0, time.monotonic()
    while process.poll() is None:
        time.sleep(1)
        if (size := log.stat().st_size) > heard:
            heard, since = size, time.monotonic()
        if time.monotonic() - since > LIMIT_S:
            process.kill()
            process.wait()
            break
    seconds = [float(line) for line in log.read_text().split()]
    log.unlink()
    if process.returncode > 0:
        raise SystemExit(f"the worker failed with exit code {process.returncode}: {' '.join(command)}")
    return seconds


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--dispatch", choices=("inline", "async"), default="inline")
    parser.add_argument("--worker", type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    main(args.dispatch) if args.worker is None else work(args.worker, args.dispatch)
