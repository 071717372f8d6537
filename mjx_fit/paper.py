"""The paper, whole: data, training, all experiments and a report; a kill loses little."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from rich.console import Console

from mjx_fit.config import Config
from mjx_fit.dataset import store
from mjx_fit.dataset.collect import collect
from mjx_fit.dataset.draws import draw_attempts
from mjx_fit.dataset.plan import Plan
from mjx_fit.errors import RequestError
from mjx_fit.evaluation import experiments
from mjx_fit.evaluation.calibrate import calibrate
from mjx_fit.evaluation.insertion import insertion
from mjx_fit.evaluation.position import position
from mjx_fit.randomness import root_key
from mjx_fit.report.build import build
from mjx_fit.simulate.engine import create
from mjx_fit.training.baseline import train_with_baseline


@dataclass(frozen=True)
class Size:
    """How much of everything.

    Attributes:
        preset: Of ``configs/``: the sensor and its training.
        episodes: Interactions to train on, in sequences of ``sequence``.
        sequence: Attempts in a row at one hole.
        held_out: Interactions to calibrate on.
        attempts: Single attempts for each shape, and mismatched ones in all.
        positions: Trials of the position experiment, of either kind.
        insertions: Draws of the insertion experiment.
        seeds: Of the wiggles, for each of them.
        assemblies: Trials of the assembly experiment.
        many: Trials of ``full`` alone, for the rate of interventions.
    """

    preset: str
    episodes: int
    sequence: int
    held_out: int
    attempts: int
    positions: int
    insertions: int
    seeds: int
    assemblies: int
    many: int


SIZES = {
    "quick": Size("quick", 1500, 3, 250, 50, 10, 15, 2, 8, 10),
    "cpu": Size("cpu", 12000, 3, 3000, 1000, 100, 150, 5, 100, 1000),
    "full": Size("paper", 120000, 3, 10000, 10000, 1000, 1500, 5, 1000, 10000),
}

ASSEMBLY = "failure_only,failure_position,full,oracle"
ATTEMPTS_EACH = 220
"""Attempts that one assembly takes under all four methods together, as they were seen: an estimate."""
WINDOW_IN_ACTIONS = 9.0
"""What a window costs in training, in simulated actions: 3 ms against 0.33 ms on two cores."""
PROBE, PROBE_ACTIONS = 256, 5


def size_of(name: str) -> Size:
    """The size of a name.

    Raises:
        RequestError: There is none.
    """
    if name not in SIZES:
        raise RequestError(f"--size: {name!r} is not allowed: choose from {', '.join(SIZES)}")
    return SIZES[name]


def paper(config: Config, out: Path, size: Size, seed: int) -> None:
    """Runs every stage into ``out``; what is done is not done again.

    Args:
        config: The configuration.
        out: Folder for everything.
        size: How much of everything.
        seed: Root seed.

    Raises:
        RequestError: The folder holds something else.
    """
    console = Console(highlight=False)
    stages = _stages(config, out, size, seed)
    console.print(_forecast(config, size))
    for number, (title, work) in enumerate(stages.items(), 1):
        console.rule(f"{number}/{len(stages)}  {title}")
        began = time.monotonic()
        work()
        console.print(f"{time.monotonic() - began:.0f} s")
    results = sorted(out.glob("*.json"))
    console.print(str(build([*results, out / "run"], out / "report")), soft_wrap=True)


def _stages(config: Config, out: Path, size: Size, seed: int) -> dict[str, Callable[[], object]]:
    data, test, run = out / "data", out / "held_out", out / "run"
    plan = Plan(size.episodes, config.task.attempt_actions, "spiral", seed=seed, sequence=size.sequence)
    test_plan = Plan(size.held_out, config.task.attempt_actions, "spiral", seed=seed + 1)
    disc = replace(config, detector=replace(config.detector, kind="disc"))
    by_covariance = replace(config, task=replace(config.task, outcome_model="covariance"))
    chosen = "full,frame_by_frame,oracle"
    inserting = "full,no_update,sample,frame_by_frame,oracle"

    def assemble(name: str, config: Config, methods: str, trials: int) -> Callable[[], object]:
        return lambda: experiments.assembly(config, out / name, run, methods, trials, seed, "auto")

    return {
        f"{size.episodes:,} interactions to train on": lambda: collect(config, data, plan),
        f"{size.held_out:,} to calibrate on": lambda: collect(config, test, test_plan),
        "train": lambda: train_with_baseline(store.load(data), config, run, seed),
        "calibration": lambda: calibrate(config, out / "calibration.json", run, test, seed),
        "single attempts": lambda: experiments.attempt(
            config, out / "attempt.json", size.attempts, seed, "auto"
        ),
        "single attempts, detector disc": lambda: experiments.attempt(
            disc, out / "attempt_disc.json", size.attempts, seed, "auto"
        ),
        "position": lambda: position(
            config, out / "position.json", run, chosen, size.positions, seed, "auto"
        ),
        "position, detector disc": lambda: position(
            disc, out / "position_disc.json", run, chosen, size.positions, seed, "auto"
        ),
        "insertion": lambda: insertion(
            config, out / "insertion.json", run, inserting, size.insertions, size.seeds, seed, "auto"
        ),
        "assembly": assemble("assembly.json", config, ASSEMBLY, size.assemblies),
        "assembly, success by the belief's covariance": assemble(
            "assembly_covariance.json", by_covariance, ASSEMBLY, size.assemblies
        ),
        "assembly, many trials of full": assemble("assembly_full.json", by_covariance, "full", size.many),
    }


def _forecast(config: Config, size: Size) -> str:
    """How long it will take, from a few simulated actions: rough, and said so."""
    actions = config.task.attempt_actions
    windows = (1 + config.train.baseline_share) * config.train.epochs * size.episodes
    attempts = (
        size.episodes
        + size.held_out
        + 8 * size.attempts
        + 2 * 2 * 3 * 4 * size.positions
        + 4 * 5 * size.insertions * size.seeds
        + 2 * ATTEMPTS_EACH * size.assemblies
        + 20 * size.many
    )
    speed = _actions_per_s(config)
    minutes = (attempts * actions + WINDOW_IN_ACTIONS * windows) / speed / 60
    return (
        f"About {attempts:,} attempts and {windows:,.0f} windows of training: roughly {minutes:,.0f} minutes "
        f"here, at {speed:,.0f} actions a second. Stopped, the same command goes on."
    )


def _actions_per_s(config: Config) -> float:
    engine = create("auto", config)
    attempts = draw_attempts(root_key(0, "forecast"), jnp.arange(PROBE), "spiral", config.detector)
    seconds = []
    for _ in range(2):  # the first compiles
        began = time.perf_counter()
        done = engine.run(attempts, PROBE_ACTIONS)
        seconds.append(time.perf_counter() - began)
    return float(np.sum(done.length)) / seconds[-1]
