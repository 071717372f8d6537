"""Reproduce the paper: data, training, all experiments and a report; a rerun resumes."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from rich.console import Console

from mjx_fit.config.schema import Config
from mjx_fit.data.collect import collect
from mjx_fit.data.plan import Plan
from mjx_fit.data.schedule import draw_attempts
from mjx_fit.engines.interface import Engine
from mjx_fit.engines.select import make_engine
from mjx_fit.evaluation.assembly import assembly
from mjx_fit.evaluation.attempt import attempt
from mjx_fit.evaluation.calibration import calibrate
from mjx_fit.evaluation.insertion import insertion
from mjx_fit.evaluation.position import position
from mjx_fit.evaluation.request import Request
from mjx_fit.evaluation.results import Result
from mjx_fit.jobs.pool import Here, Pool
from mjx_fit.report.build import build
from mjx_fit.task.estimator import filter_update
from mjx_fit.training.run import Run
from mjx_fit.training.sensor_loader import load_trained_sensor
from mjx_fit.training.train import train_from
from mjx_fit.utils import files, locks
from mjx_fit.utils.errors import RequestError, shown
from mjx_fit.utils.filesystem import path_inside
from mjx_fit.utils.randomness import require_seed, root_key


@dataclass(frozen=True)
class Size:
    """Size of the reproduction.

    Attributes:
        preset: Preset in ``configs/`` for the sensor and its training.
        episodes: Training episodes, in sequences of ``sequence``.
        sequence: Consecutive attempts at one hole.
        held_out: Calibration episodes.
        own: Calibration episodes by attempt: five consecutive ones, from the sensor's posterior.
        attempts: Single matched attempts per shape, and mismatched attempts in total.
        positions: Trials of the position experiment, matched and mismatched each.
        insertions: Draws of the insertion experiment.
        seeds: Seeds of the exploration noise for each draw.
        assemblies: Trials of the assembly experiment.
        many: Trials of ``full`` alone, for the intervention rate.
    """

    preset: str
    episodes: int
    sequence: int
    held_out: int
    own: int
    attempts: int
    positions: int
    insertions: int
    seeds: int
    assemblies: int
    many: int


SIZES = {
    "quick": Size("cpu", 1500, 3, 250, 300, 50, 10, 15, 2, 8, 10),
    "cpu": Size("cpu", 12000, 3, 3000, 10000, 1000, 100, 150, 5, 100, 1000),
    "full": Size("paper", 120000, 3, 10000, 30000, 10000, 1000, 1500, 5, 1000, 10000),
}

POSITION = "full,frame_by_frame,oracle"
INSERTION = "full,no_update,sample,frame_by_frame,oracle"
ASSEMBLY = "failure_only,failure_position,full,perfect_match,perfect_sensor,oracle"
ATTEMPTS_EACH, ATTEMPTS_FULL = 167, 11
"""Observed attempts per assembly, summed over all methods, and for ``full`` alone."""
WINDOW_IN_ACTIONS = 9.0
"""Training cost of a window in simulated actions: 3 ms against 0.33 ms on two cores."""
PROBE, PROBE_ACTIONS = 256, 5
HELD_OUT, OWN = 1, 2
"""Seed offsets of held-out and on-policy data, so that their holes differ from the training's."""
RESULTS = (
    "calibration",
    "calibration_by_attempt",
    "attempt",
    "attempt_disc",
    "position",
    "position_disc",
    "insertion",
    "insertion_disc",
    "assembly",
    "assembly_covariance",
    "assembly_full",
)


def size_of(name: str) -> Size:
    """Return the size with this name.

    Raises:
        RequestError: The name is unknown.
    """
    if name not in SIZES:
        raise RequestError(f"--size: {shown(name)} is invalid: choose from {', '.join(SIZES)}")
    return SIZES[name]


def run_paper(config: Config, out: Path, size: Size, seed: int, pool: Pool | None = None) -> None:
    """Run every stage into ``out``; a rerun skips finished stages.

    Args:
        config: The configuration.
        out: Folder for everything.
        size: Size of the reproduction.
        seed: Root seed.
        pool: Simulates data and experiments; None: this process.

    Raises:
        RequestError: The folder holds something else, or the configuration trains no baseline.
    """
    _check(config, out, seed)
    with locks.holding(out):
        engine = make_engine("auto", config)
        _run(Request(config, out, engine, trials=0, seed=seed, pool=pool or Here()), size)


def _run(base: Request, size: Size) -> None:
    """Run the stages; they share an engine, which depends on neither detector nor outcome model."""
    console, out = Console(highlight=False, emoji=False), base.out
    stages = _stages(base, size)
    console.print(_forecast(base.config, size, base.engine))
    for number, (title, work) in enumerate(stages.items(), 1):
        console.rule(f"{number}/{len(stages)}  {title}")
        began = time.monotonic()
        work()
        console.print(f"{time.monotonic() - began:.0f} s")
    console.print(
        str(build([*sorted(out.glob("*.json")), out / "run"], path_inside(out, "report"))), soft_wrap=True
    )


def _check(config: Config, out: Path, seed: int) -> None:
    """Refuse invalid requests before hours of computation."""
    require_seed(seed)
    require_seed(seed + OWN)
    if not config.train.baseline_share:
        raise RequestError(
            "config: train.baseline_share: 0.0 is invalid: expected above 0, to have frame_by_frame"
        )
    parts = {"data", "held_out", "own", "run", "report"}
    parts |= {f"{name}{end}" for name in RESULTS for end in (".json", ".parts", ".broken")}
    foreign = files.foreign(out, parts)
    if foreign:
        raise RequestError(f"--out: {out} cannot be used: it holds other files ({foreign[0]})")


def _stages(base: Request, size: Size) -> dict[str, Callable[[], object]]:
    """Return the stages by title; ``base`` holds the fields shared by all requests, ``out`` the folder."""
    config, out, engine, seed, pool = base.config, base.out, base.engine, base.seed, base.pool
    data, test, run = (path_inside(out, name) for name in ("data", "held_out", "run"))
    plan = Plan(size.episodes, config.task.attempt_actions, "spiral", seed=seed, sequence=size.sequence)
    test_plan = Plan(size.held_out, config.task.attempt_actions, "spiral", seed=seed + HELD_OUT)
    disc = replace(config, detector=replace(config.detector, kind="disc"))
    by_covariance = replace(config, task=replace(config.task, outcome_model="covariance"))

    def measure(
        experiment: Callable[[Request], object], name: str, config: Config, trials: int, methods: str
    ) -> Callable[[], object]:
        request = replace(base, config=config, out=out / f"{name}.json", trials=trials, methods=methods)
        return lambda: experiment(request.with_sensors_of(run) if methods else request)

    def inserted(request: Request) -> Result:
        return insertion(replace(request, seeds=size.seeds))

    return {
        f"{size.episodes:,} episodes to train on": lambda: collect(config, data, plan, engine, pool=pool),
        f"{size.held_out:,} to calibrate on": lambda: collect(config, test, test_plan, engine, pool=pool),
        "train": lambda: train_from([data], config, Run(run, seed)),
        "calibration": lambda: calibrate(config, out / "calibration.json", run, test, seed),
        "calibration by attempt": lambda: _by_attempt(replace(base, seed=seed + OWN), run, size.own),
        "single attempts": measure(attempt, "attempt", config, size.attempts, ""),
        "single attempts, detector disc": measure(attempt, "attempt_disc", disc, size.attempts, ""),
        "position": measure(position, "position", config, size.positions, POSITION),
        "position, detector disc": measure(position, "position_disc", disc, size.positions, POSITION),
        "insertion": measure(inserted, "insertion", config, size.insertions, INSERTION),
        "insertion, detector disc": measure(inserted, "insertion_disc", disc, size.insertions, INSERTION),
        "assembly": measure(assembly, "assembly", config, size.assemblies, ASSEMBLY),
        "assembly, by covariance": measure(
            assembly, "assembly_covariance", by_covariance, size.assemblies, ASSEMBLY
        ),
        "assembly, many trials of full, by covariance": measure(
            assembly, "assembly_full", by_covariance, size.many, "full"
        ),
    }


def _by_attempt(base: Request, run: Path, episodes: int) -> None:
    """Calibrate on consecutive attempts that start from the sensor's posterior."""
    config, out = base.config, base.out
    sensor = load_trained_sensor(run)
    actions = config.task.attempt_actions
    plan = Plan(episodes, actions, "spiral", seed=base.seed, sequence=5, sensor=sensor.fingerprint)
    update = filter_update(config, sensor.network)
    collect(config, path_inside(out, "own"), plan, base.engine, update, base.pool)
    calibrate(config, out / "calibration_by_attempt.json", run, out / "own", base.seed)


def _forecast(config: Config, size: Size, engine: Engine) -> str:
    """Estimate the total time from a few simulated actions."""
    actions = config.task.attempt_actions
    windows = (1 + config.train.baseline_share) * config.train.epochs * size.episodes
    attempts = (
        size.episodes
        + size.held_out
        + size.own
        + 8 * size.attempts
        + 2 * 2 * 3 * 4 * size.positions
        + 2 * 4 * 5 * size.insertions * size.seeds
        + 2 * ATTEMPTS_EACH * size.assemblies
        + ATTEMPTS_FULL * size.many
    )
    speed = _actions_per_s(config, engine)
    minutes = (attempts * actions + WINDOW_IN_ACTIONS * windows) / speed / 60
    return (
        f"About {attempts:,} attempts and {windows:,.0f} windows of training: roughly {minutes:,.0f} minutes "
        f"here, at {speed:,.0f} actions a second. Rerun the command to resume."
    )


def _actions_per_s(config: Config, engine: Engine) -> float:
    attempts = draw_attempts(root_key(0, "forecast"), jnp.arange(PROBE), "spiral", config)
    seconds = []
    for _ in range(2):  # the first compiles
        began = time.perf_counter()
        done = engine.run(attempts, PROBE_ACTIONS)
        seconds.append(time.perf_counter() - began)
    return float(np.sum(done.felt.length)) / seconds[-1]
