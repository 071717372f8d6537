"""Algorithm 1 on whole assemblies, batched over methods and trials.

In each round every unfinished trial makes one attempt under each method; all attempts of a round are
simulated together. A trial's holes, pegs, detections and wiggles are the same for all methods.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from mjx_fit.config import Config
from mjx_fit.simulate.interface import Engine
from mjx_fit.task.learning import Learn
from mjx_fit.task.methods import Method
from mjx_fit.task.table import State, Table
from mjx_fit.task.trials import Trials
from mjx_fit.types import Interaction


@dataclass(frozen=True)
class Round:
    """One attempt of every active row.

    Attributes:
        before: As the attempt began.
        chosen: (R,), the hole that was tried.
        interactions: (R,), what happened; meaningless for a row that was not active.
        learned: As it had been learned from, the peg still in hand.
        after: As the next attempt begins.
    """

    before: State
    chosen: Int[np.ndarray, "R"]
    interactions: Interaction
    learned: State
    after: State


def run(
    config: Config,
    methods: tuple[Method, ...],
    trials: Trials,
    seed: int,
    engine: Engine,
    learn: Learn,
    progress: Callable[[int, str], None],
    watch: Callable[[Round], None] | None = None,
    only: int | None = None,
) -> list[dict]:
    """Runs every method on every trial to the end.

    An attempt whose simulation broke counts as a failed one from which nothing was learned.

    Args:
        config: Task, detector and physics.
        methods: What to compare.
        trials: Drawn by ``mjx_fit.task.trials.draw_trials``.
        seed: Root seed of wiggles and sensor noise.
        engine: Simulates the attempts.
        learn: Updates beliefs, made by ``mjx_fit.task.learning.learner``.
        progress: Told the number of pegs done, over all methods and trials.
        watch: Told every round, for pictures.
        only: Play this row alone, of methods times trials. Beliefs are updated in a batch of all the same,
            so that it comes out as among the others, bit by bit.

    Returns:
        One row for each method and trial, as ``mjx_fit.evaluation.trial_rows.AssemblyTrial`` has it.
    """
    table = Table(config, methods, trials, seed)
    if only is not None:
        table.leave_out_all_but(only)
    while table.active.any():
        choice = table.choose()
        chosen = choice.hole
        wiggle_keys, noise_keys = table.keys()
        attempts = table.attempts(chosen, wiggle_keys)
        interactions = engine.run(attempts, config.task.attempt_actions, table.active)
        before = table.now()
        table.learn(choice, interactions, noise_keys, learn)
        learned = table.now()
        table.record(chosen, interactions)
        if watch:
            watch(Round(before, chosen, interactions, learned, table.now()))
        progress(int(table.pegs_done.sum()), f"{table.active.sum()} of {len(table.active)} assemblies open")
    return table.rows()
