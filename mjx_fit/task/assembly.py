"""Algorithm 1 on whole assemblies, batched over methods and trials.

In each round every unfinished trial makes one attempt under each method; all attempts of a round are
simulated together. A trial's holes, pegs, detections and exploration noise are the same for all methods.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from jaxtyping import Int

from mjx_fit.config.schema import Config
from mjx_fit.engines.interface import Engine
from mjx_fit.sensors.contact_sensor import ContactSensor
from mjx_fit.task.assembly_state import State, Table
from mjx_fit.task.attempt_loop import attempt_rounds
from mjx_fit.task.estimator import Update, filter_update
from mjx_fit.task.methods import Method, of_rows
from mjx_fit.types import Rollout


@dataclass(frozen=True)
class Round:
    """One attempt of every active row.

    Attributes:
        before: As the attempt began.
        chosen: (R,), the hole that was tried.
        rollouts: (R,), what happened; meaningless for a row that was not active.
        learned: As it had been learned from, the peg still in hand.
        after: As the next attempt begins.
    """

    before: State
    chosen: Int[np.ndarray, "R"]
    rollouts: Rollout
    learned: State
    after: State


def rounds(table: Table, engine: Engine, update: Update) -> Iterator[Round]:
    """Plays every row of a table to its end, one attempt of each at a time; stop to iterate to stop to play.

    An attempt whose simulation diverged counts as a failed one from which nothing was learned.

    Args:
        table: The assemblies; it holds where they stand after the latest round.
        engine: Simulates the attempts.
        update: The update of all rows, as ``update_of_rows`` makes it.
    """
    for tried in attempt_rounds(table.next_try, engine, update, table.attempt_actions):
        before = table.now()
        table.learn(tried)
        learned = table.now()
        table.record(tried)
        yield Round(before, table.choice.hole, tried.rollouts, learned, table.now())


def update_of_rows(
    config: Config, methods: tuple[Method, ...], n_trials: int, sensor: ContactSensor | None
) -> Update:
    """Makes the belief update of a table's rows, each by what its method may learn.

    Args:
        config: Task, wrist and scene.
        methods: Those of the table.
        n_trials: Its number of trials.
        sensor: The trained sensor; None when no method reads traces.
    """
    traits = ("learns_position", "learns_type")
    return filter_update(config, sensor, *(of_rows(methods, n_trials, attrgetter(name)) for name in traits))
