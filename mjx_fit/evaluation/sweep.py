"""Sweep: an experiment in each cell of settings and seeds, summarised by setting."""

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from mjx_fit.config.schema import Config
from mjx_fit.config.sweep_file import Sweep, SweepPlan
from mjx_fit.engines.interface import Engine
from mjx_fit.evaluation import assembly as assemblies
from mjx_fit.evaluation import attempt as attempts
from mjx_fit.evaluation import insertion as insertions
from mjx_fit.evaluation import parts, result_file
from mjx_fit.evaluation import position as positions
from mjx_fit.evaluation.parts import Rows
from mjx_fit.evaluation.request import Request
from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.statistics import Row
from mjx_fit.jobs.pool import Here, Tell
from mjx_fit.task.methods import ASSEMBLY, INSERTION, POSITION, chosen
from mjx_fit.utils.progress import Progress

EXPERIMENTS: dict[str, tuple[Callable[[Request], Result], Callable[[Rows], list[Row]]]] = {
    "attempt": (attempts.attempt, attempts.summarise),
    "position": (positions.position, positions.summarise),
    "insertion": (insertions.insertion, insertions.summarise),
    "assembly": (assemblies.assembly, assemblies.summarise),
}
"""Function and summary of each experiment that can be swept."""
MAIN: dict[str, tuple[tuple[str, str], ...]] = {
    "attempt": (("success_rate", "matched"), ("peak_force_n", "matched")),
    "position": (("position_error_cm", "1"), ("coverage_90", "1")),
    "insertion": (("success_rate", "3"), ("seconds", "all")),
    "assembly": (("attempts", "all"), ("intervention_rate", "all")),
}
"""Metrics of each experiment that a sweep is about, with their groups; its file has the others, too."""
BETWEEN = " | "
"""Between setting and group in the groups of a sweep's summary."""

_METHODS: dict[str, Any] = {"position": POSITION, "insertion": INSERTION, "assembly": ASSEMBLY}

_Cell = tuple[int, int]
"""Index of the setting, and root seed."""


class EngineOf:
    """Engines of configurations. The last one is kept: the seeds of a setting share what it compiled.

    Args:
        make: Function that returns the engine of a configuration, and the configuration with what its policy
            brings; it must pickle.
    """

    def __init__(self, make: Callable[[Config], tuple[Config, Engine]]):
        self._make = make
        self._last: tuple[Config, tuple[Config, Engine]] | None = None

    def __call__(self, config: Config) -> tuple[Config, Engine]:
        """Return the configuration to run with, and its engine."""
        if self._last is None or self._last[0] != config:
            self._last = config, self._make(config)
        return self._last[1]

    def __reduce__(self) -> tuple[Any, ...]:
        return EngineOf, (self._make,)


def sweep(asked: Sweep, request: Request, engine_of: EngineOf) -> Result:
    """Run every cell of a sweep; the same request resumes it at the cell that was stopped.

    Trials are those of the experiment, with ``cell``, the index of the setting, and ``root_seed``. Rows of
    the summary have groups ``SETTING | GROUP``, such as ``friction=0.3 | matched``, and pool the seeds.

    Args:
        asked: The sweep.
        request: Request of the experiments: output, engine, sensors and pool. The rest is the plan's.
        engine_of: Engines of the settings.

    Raises:
        RequestError: A value is invalid, a method lacks its sensor, or the file holds another result.
    """
    plan = asked.plan
    if plan.methods:  # refused before any work
        chosen(",".join(plan.methods), _METHODS[plan.experiment])
    # The experiments of cells differ in their configuration and seed alone.
    request = replace(
        request,
        config=asked.base,
        trials=plan.trials,
        seed=plan.root_seeds[0],
        methods=",".join(plan.methods),
    )
    entries = {
        "of": plan.experiment,
        "cells": list(plan.settings),
        "root_seeds": list(plan.root_seeds),
        "trials": plan.trials,
        "methods": list(plan.methods),
        "sensor": request.sensor.fingerprint if request.sensor else None,
        **request.asked_policy(),
    }
    here = result_file.header("sweep", asked.base, request.seed, request.engine.name, entries)
    result = result_file.once(request.out, here, lambda: _worked_out(asked, request, engine_of, here))
    parts.finish(request.out)
    return result


def _worked_out(asked: Sweep, request: Request, engine_of: EngineOf, here: result_file.Header) -> Result:
    plan, configs = asked.plan, asked.configs
    cells = [(k, seed) for k in range(len(configs)) for seed in plan.root_seeds]
    alone = replace(request, pool=Here())

    def work(cell: _Cell, _: Tell) -> Rows:
        number, seed = cell
        config, engine = engine_of(configs[number])
        return _trials(plan, replace(alone, config=config, seed=seed, engine=engine), number)

    with Progress("sweep: cells", len(cells), parts.kept(request.out)) as progress:

        def told(_: Rows, __: int, text: str) -> None:
            progress(parts.kept(request.out), text)

        rows = parts.in_parts(request.out, here, cells, work, told, request.pool)
    return result_file.write(request.out, here, summarise(plan, rows), rows)


def _trials(plan: SweepPlan, request: Request, number: int) -> Rows:
    """Return the trials of a cell."""
    run, _ = EXPERIMENTS[plan.experiment]
    with tempfile.TemporaryDirectory(prefix="mjx_fit-cell-") as folder:
        result = run(replace(request, out=Path(folder) / "cell.json"))
    return [{"cell": number, "root_seed": request.seed, **trial} for trial in result.trials]


def summarise(plan: SweepPlan, trials: Rows) -> list[Row]:
    """Summarise the trials of each setting, over all seeds, as the experiment does."""
    _, of_trials = EXPERIMENTS[plan.experiment]
    place, rows = {seed: k for k, seed in enumerate(plan.root_seeds)}, list[Row]()
    for number, settings in enumerate(plan.settings):
        own = [
            # Trials of other seeds are other trials, with clusters of their own.
            {**trial, "trial": trial["trial"] + place[trial["root_seed"]] * _MOST_TRIALS}
            for trial in trials
            if trial["cell"] == number
        ]
        name = label(settings)
        rows += [replace(row, group=f"{name}{BETWEEN}{row.group}") for row in of_trials(own)]
    return rows


def main_rows(result: Result) -> list[Row]:
    """Return the rows of the metrics that a sweep is about."""
    return [
        row
        for metric, group in MAIN[result.request["of"]]
        for row in result.summary
        if row.metric == metric and row.group.endswith(f"{BETWEEN}{group}")
    ]


def label(settings: dict[str, Any]) -> str:
    """Return the name of a setting: its keys, without sections where these tell nothing apart."""
    short = {path: path.partition(".")[2] for path in settings}
    names = short if len(set(short.values())) == len(short) else {path: path for path in settings}
    return ", ".join(f"{names[path]}={value}" for path, value in settings.items()) or "as it is"


_MOST_TRIALS = 10**7
"""More than an experiment has."""
