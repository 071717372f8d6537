"""Playback of one assembly, attempt by attempt: a new one, or a replay from a result file."""

from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Int

from mjx_fit.config.schema import Config, config_from_stored
from mjx_fit.engines.interface import Engine
from mjx_fit.evaluation import parts, result_file
from mjx_fit.evaluation.recording import Recording, Step, require_attempt
from mjx_fit.evaluation.results import Result
from mjx_fit.scene.scenarios import draw_trials
from mjx_fit.task.assembly import Round, confirmation_of_rows, rounds, update_of_rows
from mjx_fit.task.assembly_state import Table
from mjx_fit.task.methods import ASSEMBLY, Method, chosen
from mjx_fit.training.sensor_loader import TrainedSensor
from mjx_fit.utils.errors import RequestError, require, shortened, shown
from mjx_fit.utils.progress import Progress
from mjx_fit.utils.randomness import require_seed


@dataclass(frozen=True)
class Pick:
    """Selection of the assembly to play.

    Attributes:
        method: Name of the method.
        trial: Id of the trial.
        attempt: Number of the single attempt to show, or None for all; later attempts are not simulated.
    """

    method: str
    trial: int
    attempt: int | None = None


def record(
    config: Config, pick: Pick, seed: int, engine: Engine, sensor: TrainedSensor | None = None
) -> Generator[Recording]:
    """Play one assembly, up to the selected attempt; close the generator to stop.

    Args:
        config: Configuration.
        pick: Selection of the assembly.
        seed: Root seed.
        engine: Engine that simulates the attempts.
        sensor: Trained sensor, for methods that use traces.

    Yields:
        The recording so far, after each attempt.

    Raises:
        RequestError: Raised at the call: the method is unknown or lacks its sensor, or the attempt number
            exceeds the maximum of an assembly.
    """
    require("--trial", pick.trial, 0, result_file.MAX_TRIALS - 1)
    require_seed(seed)
    picked = (_only(pick.method),)
    require_attempt(pick.attempt, config.task.n_holes * config.task.max_attempts)
    return _play(_Assemblies(config, picked, np.array([pick.trial]), seed), pick, engine, sensor)


def replay(
    result: Result, pick: Pick, engine: Engine, sensor: TrainedSensor | None = None
) -> Generator[Recording]:
    """Replay a trial of an assembly result.

    Args:
        result: Result of the assembly experiment.
        pick: Selection of one of its methods and trials.
        engine: Engine of the result, built for its configuration.
        sensor: Sensor that the result was made with.

    Yields:
        The recording so far, after each attempt.

    Raises:
        RequestError: Raised at the call: the result is from another experiment or lacks the trial or attempt,
            or the sensor differs. Raised at the end: the chosen holes differ from the result, for example
            after a change of versions or machine.
    """
    if result.experiment != "assembly":
        raise RequestError(f"result: {result.experiment!r} is invalid: expected 'assembly'")
    policy = result.request.get("policy")
    if policy and policy != engine.policy_name:
        if engine.policy_name:
            raise RequestError("--run: the result was made with another sensor; pass that run")
        raise RequestError(f"result: policy: {shown(policy)} cannot be used: a result does not hold it")
    if not result.trials:
        raise RequestError("result: trials cannot be used: the list is empty")
    rows = {(row["method"], row["trial"]): row for row in result.trials}
    names = list(dict.fromkeys(name for name, _ in rows))
    wanted = pick.method, pick.trial
    if wanted not in rows:
        raise RequestError(
            f"--method, --trial: {shortened(pick.method)}, {shown(pick.trial)} are not in the result: "
            f"it has {', '.join(names)} and trials 0 to {max(row['trial'] for row in result.trials)}"
        )
    _only(pick.method)
    require_attempt(pick.attempt, sum(rows[wanted]["attempts"]))
    made_with = result.request.get("sensor")
    if made_with and sensor and sensor.fingerprint != made_with:
        raise RequestError("--run: the result was made with another sensor; pass that run")
    trials = result.request.get("trials")
    if not isinstance(trials, int) or trials <= max(number for _, number in rows):
        raise RequestError(
            f"result: request.trials: {trials!r} is invalid: expected the number of its trials"
        )
    config = config_from_stored(result.config)
    pieces = parts.pieces(trials, len(names), engine.name, config, result.request.get("part_rows"))
    ids = next(piece for piece in pieces if pick.trial in piece)
    picked = chosen(",".join(names), ASSEMBLY)
    assemblies = _Assemblies(config, picked, ids, result.seed)
    tried = [hole for holes in rows[wanted].get("tried", []) for hole in holes]
    return _compared(_play(assemblies, pick, engine, sensor), tried[: pick.attempt], pick)


def _compared(played: Generator[Recording], expected: list[int], pick: Pick) -> Generator[Recording]:
    """Play, and raise an error at the end if the chosen holes differ from the expected ones."""
    with closing(played):
        chosen_so_far: list[int] = []
        for recording in played:
            chosen_so_far.append(recording.steps[-1].hole)
            yield recording
    if expected and expected != chosen_so_far:
        raise RequestError(
            f"render: {pick.method}, trial {pick.trial} differs from the result: "
            "it was made with other versions or on another machine; run the experiment again"
        )


def _only(method: str) -> Method:
    """Return the method with a name.

    Raises:
        RequestError: The method is unknown.
    """
    known = {one.name: one for one in ASSEMBLY}
    if method not in known:
        raise RequestError(f"--method: {shown(method)} is invalid: choose from {', '.join(known)}")
    return known[method]


@dataclass(frozen=True)
class _Assemblies:
    """Assemblies that share a batch, so that a replayed one matches the experiment bit for bit.

    Attributes:
        config: Configuration.
        methods: Methods of the experiment.
        ids: Ids of the trials in the same part.
        seed: Root seed.
    """

    config: Config
    methods: tuple[Method, ...]
    ids: Int[np.ndarray, "T"]
    seed: int


def _play(of: _Assemblies, pick: Pick, engine: Engine, sensor: TrainedSensor | None) -> Generator[Recording]:
    """Play one row (a method and a trial) of the batch, up to an attempt or to the end."""
    config, network, methods, ids = of.config, None, of.methods, of.ids
    reading = [one.name for one in methods if one.needs_sensor]
    if reading and config.filter.reads != "geometry":
        # Any row may need the sensor: all beliefs are updated in one batch.
        if sensor is None:
            raise RequestError(f"--run is required: method {reading[0]!r} needs a trained sensor")
        config, network = sensor.adapt(config), sensor.network
        sensor.say_if_away(config, "playing")
    drawn, place = draw_trials(config, of.seed, ids), int(np.flatnonzero(ids == pick.trial)[0])
    table, update = Table(config, methods, drawn, of.seed), update_of_rows(config, methods, len(ids), network)
    confirm = confirmation_of_rows(config, methods, len(ids), network)
    row = [one.name for one in methods].index(pick.method) * len(ids) + place
    table.leave_out_all_but(row)
    world = drawn.hole_type[place], drawn.hole_pos_world[place], drawn.peg_type[place]
    physics = jax.tree.map(lambda leaf: leaf[place], drawn.physics)
    empty = Recording(pick.method, pick.trial, config, *world, steps=(), physics=physics)
    return _steps(empty, table, row, rounds(table, engine, update, confirm), pick.attempt)


def _steps(
    played: Recording, table: Table, row: int, rounds_: Iterator[Round], last: int | None
) -> Generator[Recording]:
    """Yield the recording of a row after each round."""
    others_done = int(table.pegs_done.sum())
    with Progress("playing: pegs", played.config.task.n_holes) as progress:
        for round_ in rounds_:
            played = replace(played, steps=(*played.steps, _step_of(round_, row, played.steps)))
            yield played
            if len(played.steps) == last:
                return
            progress(int(table.pegs_done.sum()) - others_done, f"{len(played.steps)} attempts")


def _step_of(round_: Round, row: int, so_far: tuple[Step, ...]) -> Step:
    """Return the step of a row in a round."""
    peg = int(round_.before.peg[row])
    happened = jax.tree.map(lambda leaf: np.asarray(leaf)[row], round_.rollouts)
    newly = np.flatnonzero(round_.after.filled[row] & ~round_.before.filled[row])
    return Step(
        number=len(so_far) + 1,
        peg=peg,
        attempt=1 + sum(step.peg == peg for step in so_far),
        hole=int(round_.chosen[row]),
        rollout=happened,
        before=jax.tree.map(lambda leaf: leaf[row], round_.before.beliefs),
        after=jax.tree.map(lambda leaf: leaf[row], round_.learned.beliefs),
        content=round_.before.content[row],
        helped=int(newly[0]) if len(newly) and not happened.taken else None,
    )
