"""Insertions told by what the robot measures: the engines' verdict, and what loops and scores make of it."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from fakes import FakeEngine, T, halving, make_holes

from mjx_fit.api import draw_attempts
from mjx_fit.cli.main import main
from mjx_fit.config.schema import Config
from mjx_fit.engines.select import make_engine
from mjx_fit.evaluation.results import read, summarise_sensed
from mjx_fit.scene import scenarios
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.task import assembly, methods, single_hole
from mjx_fit.task.assembly_state import Table
from mjx_fit.task.estimator import filter_update

N, ACTIONS = 12, 15
SENSED = replace(Config(), task=replace(Config().task, success="sensed"))


@pytest.mark.parametrize(
    ("engine", "errors"),
    [
        ("native", {}),
        ("native", {"position_noise_m": 0.003}),
        ("native", {"height_offset_m": 0.005}),
        pytest.param("mjx", {}, marks=pytest.mark.slow),
        pytest.param("mjx", {"position_noise_m": 0.003}, marks=pytest.mark.slow),
    ],
)
def test_the_attempt_ends_with_the_first_measured_depth_and_the_truth_is_that_of_its_end(engine, errors):
    margin_m = SENSED.task.sensed_margin_m
    config = replace(SENSED, pose=replace(SENSED.pose.without_errors(), **errors))
    attempts = draw_attempts(jax.random.key(5), N, config=config)
    attempts = replace(attempts, hole_type=attempts.peg_type, estimate_world=attempts.hole_pos_world + 0.0005)
    done = make_engine(engine, config).run(attempts, ACTIONS)
    height = np.asarray(done.felt.trace.tip_pos_world[..., 2])
    below = plate_top_m(config.scene) - height
    last = np.arange(N), done.felt.length - 1
    assert done.sensed is not None
    assert done.sensed.any()
    np.testing.assert_array_equal(done.truth.inserted, below[last] >= config.task.insertion_depth_m)
    if not errors:
        deep = (below >= config.task.insertion_depth_m + margin_m) & (height != 0)
        first = np.where(deep.any(1), deep.argmax(1) + 1, ACTIONS)
        np.testing.assert_array_equal(done.felt.length, first)
        np.testing.assert_array_equal(done.sensed, deep.any(1))
    else:
        # Errors of this size exceed the margin: some verdicts come early.
        assert (done.sensed & ~done.truth.inserted).any()
        assert (done.felt.length[~done.sensed] == ACTIONS).all()


class Mistaken(FakeEngine):
    """The robot notices no insertion of the first round, and takes every peg of the second for inserted."""

    def run(self, attempts, actions=None, active=None, horizon=None):
        done = super().run(attempts, actions, active, horizon)
        return replace(done, sensed=np.full(T, len(self.seen) > 1))


def test_the_loop_runs_on_what_was_sensed_and_the_truth_scores():
    holes, engine = make_holes(), Mistaken()
    picked = (methods.INSERTION[0],)
    table = single_hole.HoleTable(SENSED, picked, holes, 5)
    assert [*single_hole.rounds(table, engine, single_hole.update_of_rows(picked, {"full": halving}))] == [
        T,
        T,
    ]
    done = table.outcomes()["full"]
    assert (done.attempts == 2).all()
    error = np.linalg.norm(done.mean_world - holes.hole_pos_world[:, None], axis=2)
    np.testing.assert_allclose(error[:, 1], error[:, 0] / 2, rtol=1e-3)  # also where the peg was in
    inserted = (holes.peg_type == holes.hole_type) & (error[:, 1] < 0.005)
    assert 0 < inserted.sum() < T
    np.testing.assert_array_equal(done.inserted_at, 2 * inserted)


class Credulous(FakeEngine):
    """The robot takes every peg for inserted."""

    def run(self, attempts, actions=None, active=None, horizon=None):
        done = super().run(attempts, actions, active, horizon)
        return replace(done, sensed=np.ones(len(done.felt.length), bool))


def test_a_peg_that_is_wrongly_taken_for_inserted_ends_its_attempts_and_is_not_in():
    drawn = scenarios.draw_trials(SENSED, 0, np.arange(30))
    table = Table(SENSED, methods.chosen("full", methods.ASSEMBLY), drawn, 0)
    happened = [*assembly.rounds(table, Credulous(), filter_update(SENSED, None))]
    mistaken = np.stack([~np.asarray(round_.rollouts.truth.inserted) for round_ in happened], 1)
    assert 0 < mistaken.sum() < mistaken.size
    rows = table.rows()
    assert all(row["attempts"] == [1] * 5 and not any(row["human"]) for row in rows)
    wrongly = [row.get("inserted_wrongly", [False] * 5) for row in rows]
    assert wrongly == mistaken.tolist()


def test_precision_and_recall_count_every_insertion_of_valid_attempts():
    def trial(sensed, inserted=False, wrongly=False, valid=True):
        return {"sensed": sensed, "inserted": inserted, "inserted_wrongly": wrongly, "valid": valid}

    trials = [
        trial(True, inserted=True), trial(True, wrongly=True), trial(True), trial(True),
        trial(False, inserted=True), trial(False), trial(True, valid=False),
    ]  # fmt: skip
    rows = {row.metric: (row.value, row.n) for row in summarise_sensed(trials, "spiral")}
    assert rows == {"sensed_precision": (0.5, 4), "sensed_recall": (pytest.approx(2 / 3), 3)}
    assert summarise_sensed([{"valid": True, "inserted": True}], "spiral") == []


def test_the_result_of_single_attempts_says_what_was_sensed(tmp_path):
    out = tmp_path / "attempt.json"
    words = ["--set", "task.success=sensed", "--set", "task.attempt_actions=2", "--trials", "4"]
    assert main(["evaluate", "attempt", "--out", str(out), "--engine", "native", *words]) == 0
    assert [trial["sensed"] for trial in read(out).trials] == [False] * 16


def test_a_run_is_refused_where_no_policy_reads_it(tmp_path, capsys):
    out = str(tmp_path / "attempt.json")
    assert main(["evaluate", "attempt", "--out", out, "--run", "gentle"]) == 2
    assert "has no effect without --policy seek" in capsys.readouterr().err
