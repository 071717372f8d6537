"""One assembly, played again from its result file's request: every attempt with all that was believed."""

import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from mjx_fit import config as config_
from mjx_fit.config import Config
from mjx_fit.errors import RequestError, require, shortened, shown
from mjx_fit.evaluation import outcome, parts
from mjx_fit.evaluation.results import Result
from mjx_fit.progress import Progress
from mjx_fit.randomness import require_seed
from mjx_fit.simulate.interface import Engine
from mjx_fit.simulate.select import make_engine
from mjx_fit.task import assembly
from mjx_fit.task.assembly import Round
from mjx_fit.task.learning import learner
from mjx_fit.task.methods import ASSEMBLY, Method, chosen
from mjx_fit.task.trials import draw_trials
from mjx_fit.training import checkpoint
from mjx_fit.training.kinship import away_from_training
from mjx_fit.types import Belief, Interaction


@dataclass(frozen=True)
class Step:
    """One attempt.

    Attributes:
        number: Of the attempt in the assembly, from 1.
        peg: Number of the peg in hand, from 0.
        attempt: Number of the attempt with it, from 1.
        hole: Which hole was tried.
        interaction: What happened.
        before: What was believed of all n holes as it began.
        after: What was believed once it had been learned from.
        filled: Which holes were filled as it began.
        helped: The hole that a human filled thereafter, or None.
    """

    number: int
    peg: int
    attempt: int
    hole: int
    interaction: Interaction
    before: Belief
    after: Belief
    filled: Bool[np.ndarray, "n"]
    helped: int | None


@dataclass(frozen=True)
class Recording:
    """One assembly under one method.

    Attributes:
        method: Its name.
        trial: Its id.
        config: The configuration.
        hole_type: (n,).
        hole_pos_world: (n, 2), m.
        peg_type: (n,), in the order in which they were grasped.
        steps: Every attempt in order.
    """

    method: str
    trial: int
    config: Config
    hole_type: Int[np.ndarray, "n"]
    hole_pos_world: Float[np.ndarray, "n 2"]
    peg_type: Int[np.ndarray, "n"]
    steps: tuple[Step, ...]

    def only(self, number: int) -> "Recording":
        """The attempt with a number, alone.

        Raises:
            RequestError: There is none.
        """
        _require_attempt(number, len(self.steps))
        return replace(self, steps=(self.steps[number - 1],))


Watch = Callable[[Recording], None]


class _PlayedError(Exception):
    """What was to be looked at has been played."""


def record(
    config: Config,
    run: Path | None,
    method: str,
    trial: int,
    seed: int,
    engine: str = "auto",
    watch: Watch | None = None,
    attempt: int | None = None,
) -> Recording:
    """Plays one assembly.

    Args:
        config: The configuration.
        run: Folder of the trained sensor, for a method that reads traces.
        method: Its name.
        trial: Its id.
        seed: Root seed.
        engine: ``auto``, ``mjx`` or ``native``.
        watch: Told after every attempt what has been played so far.
        attempt: Number of the one that will be looked at, if it is one: no later one is played.

    Raises:
        RequestError: There is no such method, it needs a sensor and there is none, or no assembly has so many
            attempts.
    """
    require("--trial", trial, 0, outcome.MAX_TRIALS - 1)
    require_seed(seed)
    picked = (_only(method),)
    _require_attempt(attempt, config.task.n_holes * config.task.max_attempts)
    return _play(config, run, picked, np.array([trial]), 0, seed, make_engine(engine, config), watch, attempt)


def replay(
    result: Result,
    run: Path,
    method: str,
    trial: int,
    watch: Watch | None = None,
    attempt: int | None = None,
) -> Recording:
    """Plays a trial of an assembly result again.

    Args:
        result: Of the assembly experiment.
        run: Folder of the sensor that it was made with.
        method: One of its methods.
        trial: One of its trials.
        watch: Told after every attempt what has been played so far.
        attempt: Number of the one that will be looked at, if it is one: no later one is played.

    Raises:
        RequestError: The result is of another experiment or has no such trial or attempt, the run is of
            another sensor, or the same choices do not come out, as after a change of versions or machine.
    """
    if result.experiment != "assembly":
        raise RequestError(f"result: {result.experiment!r} is not allowed: it must be of assembly")
    if not result.trials:
        raise RequestError("result: trials: none is not allowed: there is nothing to play")
    rows = {(row["method"], row["trial"]): row for row in result.trials}
    names = list(dict.fromkeys(name for name, _ in rows))
    if (method, trial) not in rows:
        raise RequestError(
            f"--method, --trial: {shortened(method)}, {shown(trial)} are not in the result: "
            f"it has {', '.join(names)} and trials 0 to {max(row['trial'] for row in result.trials)}"
        )
    _only(method)
    _require_attempt(attempt, sum(rows[method, trial]["attempts"]))
    sensor = result.request.get("sensor")
    if sensor and checkpoint.fingerprint_of(checkpoint.load_sensor(run)[0]) != sensor:
        raise RequestError(
            f"--run: {run} is not allowed: the result was made with another sensor; give its --run"
        )
    trials = result.request.get("trials")
    if not isinstance(trials, int) or trials <= max(number for _, number in rows):
        raise RequestError(f"result: request.trials: {trials!r} is not allowed: it must count its trials")
    config = config_.from_stored(result.config)
    engine = make_engine(result.engine, config)
    pieces = parts.pieces(trials, len(names), engine.name)
    ids = next(piece for piece in pieces if trial in piece)
    row = names.index(method) * len(ids) + int(np.flatnonzero(ids == trial)[0])
    picked = chosen(",".join(names), ASSEMBLY)
    recording = _play(config, run, picked, ids, row, result.seed, engine, watch, attempt)
    expected = [hole for holes in rows[method, trial].get("tried", []) for hole in holes][:attempt]
    if expected and expected != [step.hole for step in recording.steps]:
        raise RequestError(
            f"render: {method}, trial {trial} does not come out as in the result: "
            "it was made with other versions or on another machine; make the result anew"
        )
    return recording


def _require_attempt(number: int | None, most: int) -> None:
    """Refuse to look at an attempt that there is not."""
    if number is not None:
        require("--attempt", number, 1, most)


def _only(method: str) -> Method:
    """The method of that name.

    Raises:
        RequestError: There is none.
    """
    known = {one.name: one for one in ASSEMBLY}
    if method not in known:
        raise RequestError(f"--method: {shown(method)} is not allowed: choose from {', '.join(known)}")
    return known[method]


def _play(
    config: Config,
    run: Path | None,
    methods: tuple[Method, ...],
    ids: Int[np.ndarray, "T"],
    row: int,
    seed: int,
    engine: Engine,
    watch: Watch | None,
    last: int | None,
) -> Recording:
    """Plays one row of the methods times the trials with these ids, up to an attempt or to the end."""
    method, place = methods[row // len(ids)], row % len(ids)
    sensor, reading = None, [one.name for one in methods if one.needs_sensor]
    if reading:  # of any row: the update of all is compiled as one
        if run is None:
            raise RequestError(f"--run: none is not allowed: {reading[0]} needs a training run")
        sensor, trained = checkpoint.load_sensor(run)
        config = outcome.with_network_of(trained, config)
        if away := away_from_training(config_.differences(trained, config)):
            print(f"playing: {away}", file=sys.stderr)
    drawn = draw_trials(config, seed, ids)
    steps: list[Step] = []

    def so_far() -> Recording:
        holes, pegs = (drawn.hole_type[place], drawn.hole_pos_world[place]), drawn.peg_type[place]
        return Recording(method.name, int(ids[place]), config, *holes, pegs, tuple(steps))

    def note(round_: Round) -> None:
        steps.append(_step_of(round_, row, steps))
        if watch:
            watch(so_far())
        if len(steps) == last:
            raise _PlayedError

    with Progress("playing: pegs", config.task.n_holes) as progress:
        done_before = (len(methods) * len(ids) - 1) * config.task.n_holes

        def told(pegs: int, text: str) -> None:
            progress(pegs - done_before, f"{len(steps)} attempts")

        learn = learner(config, sensor)
        with suppress(_PlayedError):
            assembly.run(config, methods, drawn, seed, engine, learn, told, note, only=row)
    return so_far()


def _step_of(round_: Round, row: int, so_far: list[Step]) -> Step:
    """A row of a round."""
    peg = int(round_.before.peg[row])
    happened = jax.tree.map(lambda leaf: np.asarray(leaf)[row], round_.interactions)
    newly = np.flatnonzero(round_.after.filled[row] & ~round_.before.filled[row])
    return Step(
        number=len(so_far) + 1,
        peg=peg,
        attempt=1 + sum(step.peg == peg for step in so_far),
        hole=int(round_.chosen[row]),
        interaction=happened,
        before=jax.tree.map(lambda leaf: leaf[row], round_.before.beliefs),
        after=jax.tree.map(lambda leaf: leaf[row], round_.learned.beliefs),
        filled=round_.before.filled[row],
        helped=int(newly[0]) if len(newly) and not happened.inserted else None,
    )
