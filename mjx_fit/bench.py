"""Speed of the engines, side by side in one run: physics steps per second of the same attempts.

Each row is measured in a process of its own, so that its peak memory is its own. A first run compiles, a
second one is timed. ``raw_batch`` replays, on all threads and without control, the torques that ``native``
applied, so that its arms make the same contacts: what is left is what MuJoCo itself costs.
"""

import json
import multiprocessing
import os
import resource
import sys
import time
from concurrent.futures import ProcessPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
from mujoco.batch import Batch
from rich.console import Console
from rich.table import Table

from mjx_fit import provenance
from mjx_fit.config import Config
from mjx_fit.dataset.collect import draw_attempts
from mjx_fit.simulate.engine import create
from mjx_fit.simulate.native import NativeEngine
from mjx_fit.types import SUBSTEPS, Attempt

WORLDS = 256
ACTIONS = {"raw_batch": 40, "native": 40, "mjx": 4}
"""Actions that are timed: about ten seconds each on two cores."""


def bench(config: Config, as_json: bool) -> None:
    """Measures every engine and prints a table, or a JSON list of rows."""
    rows = []
    for name in ACTIONS:
        print(f"bench: {name} ...", file=sys.stderr)
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as process:
            rows.append(process.submit(_measure, name, config).result())
    raw = rows[0]["physics_steps_per_s"]
    rows = [row | {"ratio_to_raw_batch": round(row["physics_steps_per_s"] / raw, 3)} for row in rows]
    if as_json:
        print(json.dumps(rows, indent=1))
    else:
        _print(rows)


def _measure(name: str, config: Config) -> dict:
    actions = ACTIONS[name]
    attempts = draw_attempts(jax.random.key(0), jnp.arange(WORLDS), "spiral", config.detector)
    if name == "raw_batch":
        first_s, second_s, steps = _raw_batch(config, attempts, actions)
    else:
        engine = create(name, config)
        first_s, _ = _timed(lambda: engine.run(attempts, actions))
        second_s, interactions = _timed(lambda: engine.run(attempts, actions))
        # MJX computes worlds that are done as well, but only those at work count.
        steps = int(interactions.length.sum()) * SUBSTEPS
    return {
        "name": name,
        "worlds": WORLDS,
        "physics_steps_per_s": round(steps / second_s),
        "actions_per_s": round(steps / SUBSTEPS / second_s, 1),
        "compile_s": round(max(first_s - second_s, 0.0), 2),
        "peak_memory_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
    }


def _raw_batch(config: Config, attempts: Attempt, actions: int) -> tuple[float, float, int]:
    n = len(attempts.peg_type)
    torques = np.zeros((n, actions * SUBSTEPS, 7))
    done = np.zeros(n, int)

    def record(ids: np.ndarray, batch: Batch) -> None:
        torques[ids, done[ids]] = batch.bind("ctrl")
        done[ids] += 1

    engine = NativeEngine(config, os.cpu_count() or 1, on_step=record)
    engine.run(attempts, actions)

    def replay():
        batch = engine.batch_at_rest(attempts)
        return _timed(lambda: batch.rollout(torques.shape[1], torques, record=("sensordata",)))[0]

    return replay(), replay(), n * torques.shape[1]


def _timed(work):
    began = time.perf_counter()
    result = work()
    return time.perf_counter() - began, result


def _print(rows: list[dict]) -> None:
    table = Table(title=f"{WORLDS} worlds on {provenance.device()}, {os.cpu_count()} host threads")
    for column in rows[0]:
        table.add_column(column.replace("_", " "), justify="left" if column == "name" else "right")
    for row in rows:
        table.add_row(*(f"{value:,}" if isinstance(value, int) else str(value) for value in row.values()))
    Console().print(table)
