"""Measure the engines and their peers side by side in one run, on the same attempts and windows.

Each row is measured in two separate processes, so that its memory is not shared: the first compiles into an
empty cache, the second reads that cache and is timed when warm.
"""

import json
import os
import resource
import sys
import tempfile
import time
from typing import Any

import jax
from rich.console import Console
from rich.table import Table

from mjx_fit.cli.bench import training
from mjx_fit.cli.bench.engines import CONTENDERS, attempts_of
from mjx_fit.cli.bench.peers import absence
from mjx_fit.config.schema import Config
from mjx_fit.utils import children, process_setup, provenance
from mjx_fit.utils.rates import SUBSTEPS

WORLDS = {"cpu": 256, "gpu": 4096, "tpu": 4096}
ACCELERATOR_ACTIONS = 100
TIMES = 3
"""Number of runs, of which the fastest counts: other processes can only slow a run down."""


def bench(config: Config, as_json: bool) -> None:
    """Measure every contender and print a table, or a JSON list of rows."""
    worlds = WORLDS[jax.default_backend()]
    rows = []
    for number, name in enumerate(CONTENDERS, 1):
        peer = CONTENDERS[name].peer
        if peer and (why := absence(peer)):
            print(f"bench: {name}: skipped, {why}", file=sys.stderr)
            continue
        print(f"bench: {name} ({number} of {len(CONTENDERS)}) ...", file=sys.stderr)
        rows.append(measure(name, config, worlds))
        print(f"bench: {name}: {rows[-1]['physics_steps_per_s']:,} physics steps/s", file=sys.stderr)
    raw = rows[0]["physics_steps_per_s"]
    rows = [row | {"ratio_to_raw_batch": round(row["physics_steps_per_s"] / raw, 3)} for row in rows]
    if why := absence("torch_twin"):
        print(f"bench: train_step_torch: skipped, {why}", file=sys.stderr)
    print("bench: train_step ...", file=sys.stderr)
    steps = training.measure(config)
    if as_json:
        print(json.dumps([*rows, *(dict.fromkeys(rows[0]) | row for row in steps)], indent=1))
    else:
        _print(rows, f"{provenance.device()}, {os.cpu_count()} host threads")
        _print(
            steps,
            f"training step, {config.train.batch_size} windows of up to {config.train.max_window} actions",
        )


def measure(name: str, config: Config, worlds: int) -> dict[str, Any]:
    """Measure one row: the speed of a contender with this number of worlds."""
    with tempfile.TemporaryDirectory() as cache:
        cold, warm = (_alone(name, config, worlds, cache, times) for times in (1, TIMES))
    return {
        "name": name,
        "worlds": 1 if CONTENDERS[name].one_world else worlds,
        "physics_steps_per_s": round(warm["steps"] / warm["seconds"]),
        "actions_per_s": round(warm["steps"] / SUBSTEPS / warm["seconds"], 1),
        "compile_s": round(cold["extra_s"], 2),
        "cached_compile_s": round(warm["extra_s"], 2),
        "peak_memory_mb": round(warm["peak_mb"]),
    }


def _alone(name: str, config: Config, worlds: int, cache: str, times: int) -> dict[str, float]:
    with children.worker() as process:
        return process.submit(_time, name, config, worlds, cache, times).result()


def _time(name: str, config: Config, worlds: int, cache: str, times: int) -> dict[str, float]:
    jax.config.update("jax_compilation_cache_dir", cache)
    process_setup.configure()
    run = CONTENDERS[name].prepare(config, attempts_of(config, worlds), _actions(name, worlds))
    began = time.perf_counter()
    run()
    first_s = time.perf_counter() - began
    seconds, steps = [], 0
    for _ in range(times):
        began = time.perf_counter()
        steps = run()
        seconds.append(time.perf_counter() - began)
    best = min(seconds)
    return {"steps": steps, "seconds": best, "extra_s": max(first_s - best, 0.0), "peak_mb": _peak_mb()}


def _actions(name: str, worlds: int) -> int:
    """Return the number of timed actions: on a CPU, more worlds run fewer actions."""
    if jax.default_backend() != "cpu":
        return ACCELERATOR_ACTIONS
    contender = CONTENDERS[name]
    share = 1 if contender.one_world else WORLDS["cpu"] / worlds
    return max(1, min(round(contender.actions * share), ACCELERATOR_ACTIONS))


def _peak_mb() -> float:
    """Return the peak memory so far: the device's if it has its own, otherwise this process's."""
    stats = jax.devices()[0].memory_stats()
    if stats:
        return stats["peak_bytes_in_use"] / 2**20
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _print(rows: list[dict], title: str) -> None:
    table = Table(title=title)
    for column in rows[0]:
        is_name = column == "name"
        words = column.replace("_", " ")
        table.add_column(words, justify="left" if is_name else "right", overflow="fold", no_wrap=is_name)
    for row in rows:
        table.add_row(*(f"{value:,}" if isinstance(value, int) else str(value) for value in row.values()))
    Console(emoji=False).print(table)
