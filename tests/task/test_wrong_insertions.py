"""Pegs that go into holes of other types: who notices, and what is counted."""

import dataclasses

import jax
import numpy as np
import pytest
from fakes import FakeEngine, Peeking
from synthetic import with_truth

from mjx_fit.config.schema import Config
from mjx_fit.evaluation.results import summarise_assembly
from mjx_fit.scene import scenarios
from mjx_fit.task import assembly, estimator, methods
from mjx_fit.task.assembly_state import Table

EVERY_HOLE = ((0.2, 0.2, 0.2),) * 3
CONFIG = dataclasses.replace(
    Config(),
    task=dataclasses.replace(Config().task, n_holes=4, max_attempts=30, success_probability=EVERY_HOLE),
)


class Loose(FakeEngine):
    """Every peg goes into every hole, at once."""

    def run(self, attempts, actions=None, active=None, horizon=None):
        done = super().run(attempts, actions, active, horizon)
        return with_truth(done, inserted=np.ones(len(done.felt.length), bool))


def confirmed(engine: Peeking, certainty: float):
    """A sensor that tells the type of a hole with a peg in it, as sure as this."""

    def confirm(beliefs, felt, keys):
        true = np.arange(3) == np.asarray(engine.truth.hole_type)[:, None]
        logp = np.log(np.where(true, certainty, (1 - certainty) / 2))
        return dataclasses.replace(jax.tree.map(np.asarray, beliefs), type_logp=logp.astype(np.float32))

    return confirm


def played(name: str, certainty: float, n_trials: int = 8):
    """Assemblies in which every peg goes into every hole."""
    engine = Peeking(Loose())
    drawn = scenarios.draw_trials(CONFIG, 0, np.arange(n_trials))
    table = Table(CONFIG, methods.chosen(name, methods.ASSEMBLY), drawn, 0)
    update = estimator.filter_update(CONFIG, None)
    *_, last = assembly.rounds(table, engine, update, confirmed(engine, certainty))
    return drawn, table.rows(), last.after.content


@pytest.mark.parametrize("name", ["full", "perfect_sensor", "perfect_match"])
def test_who_notices_pulls_the_peg_out_and_fills_the_right_holes(name):
    drawn, rows, content = played(name, 0.98)
    assert (content == drawn.hole_type).all()
    assert not any("inserted_wrongly" in row or any(row["human"]) for row in rows)
    for row in rows:  # each attempt but the last was an insertion that did not stay
        assert row.get("pulled_out", [0] * 4) == [attempts - 1 for attempts in row["attempts"]]
        left = [
            (peg, hole) for peg, tried in zip(row["pegs"], row["tried"], strict=True) for hole in tried[:-1]
        ]
        places = left if name == "perfect_match" else [hole for _, hole in left]
        assert len(set(places)) == len(places)  # what a hole turned out to be is remembered
    assert sum(sum(row.get("pulled_out", [])) for row in rows) > 0
    value = {(row.metric, row.group): row.value for row in summarise_assembly(rows)}
    pulled = [np.mean(row.get("pulled_out", [0] * 4)) for row in rows]
    assert value["pulled_out", "all"] == pytest.approx(np.mean(pulled))


def test_who_learns_no_type_keeps_every_peg():
    drawn, rows, content = played("failure_position", 0.98)
    assert all(row["attempts"] == [1] * 4 and "pulled_out" not in row for row in rows)
    wrong = content != drawn.hole_type
    assert wrong.any()
    assert [sum(row.get("inserted_wrongly", [])) for row in rows] == wrong.sum(1).tolist()


def test_a_doubtful_sensor_pulls_pegs_out_of_their_own_holes():
    """Below a half, even the right hole is left, and a human ends it."""
    _, rows, _ = played("full", 0.4, n_trials=3)
    assert any(any(row["human"]) for row in rows)
    assert all(sum(row["pulled_out"]) > 0 for row in rows)


def noted(engine: Peeking, name: str) -> tuple[int, int]:
    """How many visits the maps of searches in vain learn from, and how many were made."""
    table = Table(
        CONFIG, methods.chosen(name, methods.ASSEMBLY), scenarios.draw_trials(CONFIG, 0, np.arange(6)), 0
    )
    in_vain, made = [], []

    def note(where, failed, tried):
        in_vain.append(failed)
        made.append(table.active.copy())

    table._revisits.note = note
    for _ in assembly.rounds(table, engine, estimator.filter_update(CONFIG, None), confirmed(engine, 0.98)):
        pass
    assert not (np.concatenate(in_vain) & ~np.concatenate(made)).any()
    return int(np.concatenate(in_vain).sum()), int(np.concatenate(made).sum())


def test_a_visit_that_ended_in_a_hole_is_no_search_in_vain():
    """Not even one whose peg is pulled out; and who learns no position learns from none."""
    lost, made = noted(Peeking(Loose()), "full")
    assert lost == 0
    assert made > 24  # some pegs were pulled out
    assert noted(Peeking(FakeEngine()), "full")[0] > 6
    lost, made = noted(Peeking(FakeEngine()), "failure_only")
    assert lost == 0
    assert made > 24
