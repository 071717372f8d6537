"""Run Algorithm 1 on whole assemblies, batched over methods and trials.

Each round makes one attempt per unfinished trial and method and simulates all of them as one batch. The
holes, pegs, detections and exploration noise of a trial are identical for all methods.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from jaxtyping import Bool, Int

from mjx_fit.config.schema import Config
from mjx_fit.engines.interface import Engine
from mjx_fit.filters.outcome_model import enters_others
from mjx_fit.sensors.contact_sensor import ContactSensor
from mjx_fit.task.assembly_snapshot import State
from mjx_fit.task.assembly_state import Table
from mjx_fit.task.attempt_loop import attempt_rounds
from mjx_fit.task.estimator import Update, filter_update
from mjx_fit.task.methods import Method, of_rows
from mjx_fit.types import Rollout


@dataclass(frozen=True)
class Round:
    """One attempt of every active row.

    Attributes:
        before: State at the start of the attempt.
        chosen: Hole that each row tried, (R,).
        rollouts: Rollout of each row, (R,); meaningless for an inactive row.
        learned: State after the belief update, with the peg still in hand.
        after: State at the start of the next attempt.
    """

    before: State
    chosen: Int[np.ndarray, "R"]
    rollouts: Rollout
    learned: State
    after: State


def rounds(table: Table, engine: Engine, update: Update, confirm: Update | None = None) -> Iterator[Round]:
    """Play every row of a table to its end, one attempt per row and round; stop iterating to stop early.

    A diverged simulation counts as a failed attempt without a belief update.

    Args:
        table: State of the assemblies, modified in place after each round.
        engine: Simulates the attempts.
        update: Belief update of all rows, from ``update_of_rows``.
        confirm: Belief update after insertions, from ``confirmation_of_rows``; None: every insertion is kept.

    Yields:
        The states and rollouts of each round.
    """
    for tried in attempt_rounds(table.next_try, engine, update, table.attempt_actions, confirm):
        before = table.now()
        table.learn(tried)
        learned = table.now()
        table.record(tried)
        yield Round(before, table.choice.hole, tried.rollouts, learned, table.now())


def update_of_rows(
    config: Config, methods: tuple[Method, ...], n_trials: int, sensor: ContactSensor | None
) -> Update:
    """Make the belief update of a table's rows; each row learns what its method allows.

    Args:
        config: Settings of the task, the F/T sensor and the scene.
        methods: Methods of the table.
        n_trials: Number of trials of the table.
        sensor: The trained sensor; None if no method uses traces.
    """
    return filter_update(config, sensor, *_traits(methods, n_trials))


def confirmation_of_rows(
    config: Config, methods: tuple[Method, ...], n_trials: int, sensor: ContactSensor | None
) -> Update | None:
    """Make the update after insertions, see ``update_of_rows``; None: every peg fits its own holes alone."""
    if not enters_others(config).any():
        return None
    return filter_update(config, sensor, *_traits(methods, n_trials), inserted=True)


def _traits(methods: tuple[Method, ...], n_trials: int) -> tuple[Bool[np.ndarray, "R"], ...]:
    names = ("learns_position", "learns_type")
    return tuple(of_rows(methods, n_trials, attrgetter(name)) for name in names)
