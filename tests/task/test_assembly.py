import dataclasses
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fakes import FakeEngine, place_of
from flax import nnx
from hypothesis import given
from hypothesis import strategies as st
from synthetic import with_truth

from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config
from mjx_fit.config.worlds import world_file
from mjx_fit.filters.outcome_model import constant_matrix, success_probability
from mjx_fit.filters.updates import initial_belief
from mjx_fit.scene import scenarios
from mjx_fit.task import assembly, estimator, greedy, methods
from mjx_fit.task.after_attempts import after_failures
from mjx_fit.task.assembly_state import Table
from mjx_fit.task.attempt_loop import attempt_rounds
from mjx_fit.types import Attempt, Observation
from mjx_fit.utils.errors import RequestError

COLUMNS = ("tried", "match_probability", "error_cm", "match_after", "error_after_cm", "peak_force_n")
WHY = ("chance", "next_best")
CONFIG = dataclasses.replace(Config(), task=dataclasses.replace(Config().task, n_holes=4, max_attempts=6))


def test_expected_reward_counts_insertions_into_the_pegs_own_holes():
    """The paper's sum has no other term; here pegs enter other holes, too, which is no success."""
    xi = np.array([[0.5, 0.3, 0.2], [0.1, 0.1, 0.8]])
    alpha = np.array([[0.3, 0.05, 0.0], [0.6, 0.2, 0.01], [0.0, 0.1, 0.4]])
    for peg in range(3):
        want = [alpha[peg, peg] * row[peg] for row in xi]
        got = greedy.expected_reward(jnp.log(xi), jnp.asarray(peg), jnp.asarray(alpha))
        assert got == pytest.approx(want, abs=1e-6)


@given(
    st.lists(st.tuples(st.floats(0, 1, width=32), st.booleans(), st.integers(0, 5)), min_size=1, max_size=6)
)
def test_greedy_takes_the_best_open_hole(holes):
    reward, filled, tries = (np.array(column) for column in zip(*holes, strict=True))
    filled[0] = False
    chosen = int(greedy.greedy(jnp.asarray(reward, jnp.float32), jnp.asarray(filled), jnp.asarray(tries)))
    assert not filled[chosen]
    best = reward[~filled].max()
    assert reward[chosen] >= best - 2e-6
    equals = [tries[i] for i in range(len(holes)) if not filled[i] and reward[i] == best]
    if reward[chosen] == best:
        assert tries[chosen] <= min(equals)
    others = [reward[i] for i in range(len(holes)) if not filled[i] and i != chosen]
    second = greedy.runner_up(jnp.asarray(reward, jnp.float32), jnp.asarray(filled), jnp.asarray(chosen))
    assert float(second) == max(others) if others else np.isnan(second)


def test_ties_go_to_the_least_tried_then_the_first():
    same, open_ = jnp.array([0.1, 0.1, 0.1]), jnp.zeros(3, bool)
    assert greedy.greedy(same, open_, jnp.array([1, 0, 0])) == 1
    assert greedy.greedy(same, jnp.array([False, True, False]), jnp.array([1, 0, 0])) == 2


def test_trials_are_fair():
    trials = scenarios.draw_trials(CONFIG, 3, np.arange(8))
    assert np.array_equal(np.sort(trials.peg_type, 1), np.sort(trials.hole_type, 1))
    error = np.abs(trials.estimate_world - trials.hole_pos_world)
    assert 0.01 < error.max() <= 0.02 + 1e-6
    fewer = scenarios.draw_trials(CONFIG, 3, np.arange(5))
    assert np.array_equal(fewer.hole_type, trials.hole_type[:5])
    assert np.array_equal(fewer.hole_pos_world, trials.hole_pos_world[:5])
    assert np.array_equal(fewer.estimate_world, trials.estimate_world[:5])


def play(names, n_trials=6, seed=0, config=CONFIG, update=None):
    trials = scenarios.draw_trials(config, seed, np.arange(n_trials))
    engine = FakeEngine()
    table = Table(config, methods.chosen(names, methods.ASSEMBLY), trials, seed)
    for _ in assembly.rounds(table, engine, update or estimator.filter_update(config, None)):
        pass
    return trials, engine, table.rows()


def test_oracle_needs_one_attempt_for_each_peg():
    trials, _, rows = play("oracle")
    assert len(rows) == 6
    for row, pegs in zip(rows, trials.peg_type, strict=True):
        assert row["attempts"] == [1] * 4
        assert row["human"] == [False] * 4
        assert row["pegs"] == [("cross", "rectangle", "square")[peg] for peg in pegs]


def test_failure_only_agrees_with_a_plain_loop():
    """Algorithm 1 written out for one trial at a time, with exact beliefs as fractions of counts."""
    trials, _, rows = play("failure_only")
    alpha = np.diag(constant_matrix(CONFIG))
    for trial, row in enumerate(rows):
        types, pegs = trials.hole_type[trial], trials.peg_type[trial]
        near = np.linalg.norm(trials.estimate_world[trial] - trials.hole_pos_world[trial], axis=1) < 0.005
        weight = np.ones((4, 3)) / 3
        filled = np.zeros(4, bool)
        for number, peg in enumerate(pegs):
            tries = np.zeros(4, int)
            attempts = 0
            while True:
                chance = np.where(filled, -1, alpha[peg] * weight[:, peg] / weight.sum(1))
                ties = np.flatnonzero(chance >= chance.max() - 1e-6)
                hole = ties[np.argmin(tries[ties])]
                attempts += 1
                tries[hole] += 1
                if types[hole] == peg and near[hole]:
                    filled[hole] = True
                    human = False
                    break
                weight[hole, peg] *= 1 - alpha[peg]
                if attempts == CONFIG.task.max_attempts:
                    filled[np.flatnonzero((types == peg) & ~filled)[0]] = True
                    human = True
                    break
            assert (row["attempts"][number], row["human"][number]) == (attempts, human)


def test_learning_the_position_ends_failures_at_the_right_hole():
    """A perfect sensor by decree: after one failure the position is known, so no peg needs a human."""

    def update(beliefs, felt, keys):
        known = dataclasses.replace(beliefs, mean_world=place_of(felt))
        updated = estimator.filter_update(CONFIG, None)(known, felt, keys)
        return jax.tree.map(np.asarray, updated)

    config = dataclasses.replace(CONFIG, task=dataclasses.replace(CONFIG.task, max_attempts=30))
    _, _, rows = play("failure_position", config=config, update=update)
    assert not any(any(row["human"]) for row in rows)
    assert max(max(row["attempts"]) for row in rows) <= 9


def test_a_perfect_sensor_needs_one_failure_at_each_hole_at_most():
    """The estimate is good enough or it fails once; no hole is tried again by a peg of another type."""
    trials, _, rows = play("perfect_sensor", n_trials=20)
    near = np.linalg.norm(trials.estimate_world - trials.hole_pos_world, axis=-1) < 0.005
    for trial, row in enumerate(rows):
        tried = [(peg, hole) for peg, holes in zip(row["pegs"], row["tried"], strict=True) for hole in holes]
        failures = [hole for peg, holes in zip(row["pegs"], row["tried"], strict=True) for hole in holes[:-1]]
        assert len(set(failures)) == len(failures)
        # At the end each hole was filled; one whose estimate was bad had to be felt before.
        assert len(tried) == 4 + len(failures)
        assert set(np.flatnonzero(~near[trial])) <= set(failures)
        assert not any(row["human"])


def test_a_perfect_match_sensor_errs_once_for_each_hole_and_type_at_most():
    """A mismatch rules one type out, not two; a failure at the right hole tells all."""
    _, _, rows = play("perfect_match", n_trials=20)
    repeated = 0
    for row in rows:
        failures = [
            (peg, hole) for peg, holes in zip(row["pegs"], row["tried"], strict=True) for hole in holes[:-1]
        ]
        assert len(set(failures)) == len(failures)
        assert not any(row["human"])
        matched = [hole for peg, hole in failures if row["holes"][hole] == peg]
        for hole in matched:  # what is known needs no second failure of any peg
            later = failures[failures.index((row["holes"][hole], hole)) + 1 :]
            assert hole not in [other for _, other in later]
        repeated += len(failures) - len({hole for _, hole in failures})
    assert repeated  # which a sensor of the type would have spared


def test_the_diary_says_what_was_believed_before_and_after():
    """First attempts: the detector's error and a third; what failure or truth make of them."""
    trials, _, rows = play("failure_only,perfect_sensor")
    error = 100 * np.linalg.norm(trials.estimate_world - trials.hole_pos_world, axis=-1)
    kept = (*COLUMNS, *WHY)
    assert all(len(row[name][i]) == row["attempts"][i] for row in rows for i in range(4) for name in kept)
    for row in rows:
        first, trial, peg = row["tried"][0][0], row["trial"], trials.peg_type[row["trial"], 0]
        before, after = (tuple(row[name][0][0] for name in COLUMNS[i : i + 2]) for i in (1, 3))
        assert before == pytest.approx((1 / 3, error[trial, first]), abs=1e-4)
        a = constant_matrix(CONFIG)[peg, peg]
        matches = float(trials.hole_type[trial, first] == peg)
        assert [row[name][0][0] for name in WHY] == pytest.approx([a / 3, a / 3], abs=1e-4)
        if row["attempts"][0] == 1:
            assert after == before
        elif row["method"] == "failure_only":
            assert after == pytest.approx(((1 - a) / (3 - a), before[1]), abs=1e-4)
        else:
            assert after == pytest.approx((matches, 0), abs=1e-4)


def test_the_diary_says_why_a_hole_was_chosen():
    """P(match) × α of the chosen hole, at least that of the next best, which ends with the other holes."""
    _, _, rows = play("failure_only,perfect_sensor,oracle")
    alpha = dict(zip(CONFIG.scene.names, np.diag(constant_matrix(CONFIG)), strict=True))
    for row in rows:
        for number, peg in enumerate(row["pegs"]):
            chance, second = (np.array(row[name][number]) for name in WHY)
            assert chance == pytest.approx(alpha[peg] * np.array(row["match_probability"][number]), abs=1e-4)
            assert np.isnan(second).all() if number == 3 else (second <= chance + 1e-4).all()
    last = next(row for row in rows if row["method"] == "oracle")
    assert last["chance"][0][0] == pytest.approx(alpha[last["pegs"][0]], abs=1e-4)


def test_methods_share_the_wiggles_and_done_rows_are_not_simulated():
    _, engine, rows = play("failure_only,oracle", n_trials=3)
    keys, active = engine.seen[0]
    assert np.array_equal(keys[:3], keys[3:])
    assert active.all()
    rounds = len(engine.seen)
    assert rounds == max(sum(row["attempts"]) for row in rows)
    assert sum(int(seen[1].sum()) for seen in engine.seen) == sum(sum(row["attempts"]) for row in rows)


class StubSensor(nnx.Module):
    """Says the same of every trace: the hole is 6 mm further in x, and probably a match."""

    def __call__(self, reading):
        n = len(reading.peg_type)
        match_model = jnp.log(jnp.array([[0.2, 0.8], [0.7, 0.3], [0.6, 0.4]]))
        return Observation(
            innovation=jnp.tile(jnp.array([0.006, 0.0]), (n, 1)),
            pos_noise_cov=jnp.tile(1e-4 * jnp.eye(2), (n, 1, 1)),
            match_logits=jnp.tile(jnp.array([0.0, 1.0]), (n, 1)),
            match_model_logp=jnp.tile(match_model, (n, 1, 1)),
        )


@pytest.mark.parametrize("hard", [True, False])
def test_each_method_learns_what_it_may_and_no_more(hard):
    """Rows: neither, position alone, both; then the same with a success, which changes nothing.

    By hand: Σ = R = 1 cm² each, so the mean moves half of 6 mm and Σ halves; the peg is a cross, so ξ is
    multiplied by (1 - α, 1, 1), and where the trace may be used by H(match | c) = (0.8, 0.3, 0.4), or by the
    mean of that and of H(mismatch | c) under the sensor's own 1 / (1 + exp(1 / T)).
    """
    n = 6
    trials = scenarios.draw_trials(CONFIG, 0, np.arange(n))
    before = initial_belief(jnp.asarray(trials.estimate_world[:, 0]), 0.01, 3)
    done = FakeEngine().run(dataclasses.replace(_attempts(trials), peg_type=np.zeros(n, int)), 2)
    done = with_truth(done, inserted=np.arange(n) >= 3, valid=np.ones(n, bool))
    position, kind = np.array([0, 1, 1] * 2, bool), np.array([0, 0, 1] * 2, bool)
    config = dataclasses.replace(CONFIG, task=dataclasses.replace(CONFIG.task, hard_match=hard))
    sensor: Any = StubSensor()
    update = estimator.filter_update(config, sensor, position, kind)
    after = after_failures(update, before, done, jax.random.split(jax.random.key(0), n))
    moved = np.asarray(after.pos_mean_world - before.pos_mean_world)
    assert moved == pytest.approx(np.array([[0, 0], [0.003, 0], [0.003, 0], *[[0, 0]] * 3]), abs=1e-6)
    assert np.asarray(after.pos_cov)[:, 0, 0] == pytest.approx([1e-4, 5e-5, 5e-5, 1e-4, 1e-4, 1e-4], rel=1e-4)
    a = constant_matrix(CONFIG)[0, 0]
    temperature = CONFIG.filter.match_temperature
    miss = 0.0 if hard else 1 / (1 + np.exp(1 / temperature))
    likelihood = (1 - miss) * np.array([0.8, 0.3, 0.4]) + miss * np.array([0.2, 0.7, 0.6])
    failure = np.array([1 - a, 1, 1])
    felt = failure * likelihood
    want = [failure / failure.sum(), failure / failure.sum(), felt / felt.sum(), *[np.ones(3) / 3] * 3]
    assert np.exp(after.type_logp) == pytest.approx(np.array(want), abs=1e-5)


def test_success_and_broken_worlds_leave_beliefs_alone():
    config = CONFIG
    trials = scenarios.draw_trials(config, 0, np.arange(3))
    beliefs = initial_belief(jnp.asarray(trials.estimate_world[:, 0]), 0.01, 3)
    rollout = FakeEngine().run(dataclasses.replace(_attempts(trials), peg_type=np.zeros(3, int)), 2)
    rollout = with_truth(
        rollout, inserted=np.array([True, False, False]), valid=np.array([True, False, True])
    )
    keys = jax.random.split(jax.random.key(0), 3)
    after = after_failures(estimator.filter_update(config, None), beliefs, rollout, keys)
    assert np.array_equal(after.type_logp[:2], beliefs.type_logp[:2])
    a = constant_matrix(config)[0, 0]
    want = np.array([1 - a, 1, 1]) / (3 - a)
    assert np.exp(after.type_logp[2]) == pytest.approx(want, abs=1e-6)


def _attempts(trials):
    n = len(trials.hole_type)
    keys = jax.random.split(jax.random.key(0), n)
    zero = np.zeros(n, int)
    return Attempt(
        zero, trials.hole_type[:, 0], trials.hole_pos_world[:, 0], trials.estimate_world[:, 0], zero, keys
    )


def test_unknown_method_is_refused():
    with pytest.raises(RequestError, match="--methods: 'best' is invalid: choose from failure_only"):
        methods.chosen("full,best", methods.ASSEMBLY)


def test_success_by_covariance_is_the_mean_over_the_belief():
    """Against a hundred thousand draws from each belief: narrow, wide, askew, narrow along one axis only."""
    then = read_config(world_file("as-2026-11"))
    task = dataclasses.replace(then.task, outcome_model="covariance")
    config = dataclasses.replace(then, task=task)
    rng = np.random.default_rng(0)
    factors = [0.001 * np.eye(2), 0.009 * np.eye(2), np.array([[0.006, 0.0], [0.003, 0.002]])]
    factors += [np.diag([config.detector.prior_std_m, 0.001])]
    cov = np.stack([factor @ factor.T for factor in factors])
    got = np.asarray(success_probability(config, jnp.asarray(cov, jnp.float32)))
    z = rng.normal(size=(100_000, 2))
    for row, factor in zip(got, factors, strict=True):
        distance = np.linalg.norm(z @ factor.T, axis=1)
        rates = task.success_by_error or ()
        want = [np.interp(distance, task.error_knots_m, rate).mean() for rate in rates]
        assert row == pytest.approx(np.diag(want), abs=0.01)
    diagonal = np.diagonal(got, axis1=1, axis2=2)
    assert diagonal[0].min() > 0.8
    assert diagonal[1].max() < 0.4
    constant = np.tile(constant_matrix(then), (4, 1, 1))
    assert np.asarray(success_probability(then, jnp.asarray(cov))) == pytest.approx(constant)
    first = initial_belief(jnp.zeros((4, 2)), config.detector.prior_std_m, 3)
    assert np.asarray(success_probability(config, first.pos_cov)) == pytest.approx(constant)


def test_failing_with_a_good_estimate_says_more_about_the_type():
    config = dataclasses.replace(CONFIG, task=dataclasses.replace(CONFIG.task, outcome_model="covariance"))
    update = estimator.filter_update(config, None)
    beliefs = initial_belief(jnp.zeros((2, 2)), 0.01, 3)
    beliefs = dataclasses.replace(beliefs, cov=beliefs.cov * jnp.array([1.0, 0.01])[:, None, None])
    zero, away = jnp.zeros(2, int), jnp.full((2, 2), 0.01)
    keys = jax.random.split(jax.random.key(0), 2)
    attempts = Attempt(zero, zero, away, jnp.zeros((2, 2)), zero, keys)
    done = FakeEngine().run(attempts, 2)
    after = update(beliefs, done.felt, attempts.key)
    wide, narrow = np.exp(np.asarray(after.type_logp))[:, 0]
    assert narrow < 0.1
    assert 0.28 < wide < 1 / 3


def test_a_human_finds_an_empty_hole_where_another_peg_sits_in_the_right_one():
    """As with shapes that fit each other's holes: no peg may end up in a filled hole."""

    class Loose(FakeEngine):
        def run(self, attempts, actions=None, active=None, horizon=None):
            done = super().run(attempts, actions, active, horizon)
            number = len(self.seen)  # the first peg goes into whatever hole it tries, the others nowhere
            return with_truth(done, inserted=np.full(len(done.felt.length), number == 1))

    for seed in range(6):
        trials = scenarios.draw_trials(CONFIG, seed, np.arange(3))
        table = Table(CONFIG, methods.chosen("failure_only", methods.ASSEMBLY), trials, seed)
        seen = list(assembly.rounds(table, Loose(), estimator.filter_update(CONFIG, None)))
        for before, after in ((one.before.filled.sum(1), one.after.filled.sum(1)) for one in seen):
            assert (after >= before).all()
        assert seen[-1].after.filled.all()


class Breaking(FakeEngine):
    """Every world of the first round breaks."""

    def run(self, attempts, actions=None, active=None, horizon=None):
        done = super().run(attempts, actions, active, horizon)
        broken = np.full(len(done.felt.length), len(self.seen) == 1)
        return with_truth(done, valid=~broken, inserted=done.truth.inserted & ~broken)


def test_a_broken_world_counts_as_an_attempt_and_teaches_nothing():
    """No method, not even one that a failure tells the truth; and beliefs are distributions all the way."""
    trials, sensor = scenarios.draw_trials(CONFIG, 0, np.arange(6)), cast(Any, StubSensor())
    update = assembly.update_of_rows(CONFIG, methods.ASSEMBLY, 6, sensor)
    seen = list(assembly.rounds(Table(CONFIG, methods.ASSEMBLY, trials, 0), Breaking(), update))
    first, second, *_ = seen
    jax.tree.map(np.testing.assert_array_equal, first.learned.beliefs, first.before.beliefs)
    assert not first.after.filled.any()
    changed = (second.learned.beliefs.type_logp != second.before.beliefs.type_logp).any((1, 2))
    for number, method in enumerate(methods.ASSEMBLY):
        own = slice(6 * number, 6 * number + 6)
        assert changed[own].any() or method.knows_truth, method.name
    for one in seen:
        total = np.exp(np.asarray(one.learned.beliefs.type_logp, float)).sum(-1)
        np.testing.assert_allclose(total, 1, atol=1e-5)


def test_no_draw_of_an_assembly_comes_twice():
    """Wiggles differ from attempt to attempt, and detections from hole to hole."""
    trials, engine, rows = play("failure_only", n_trials=5)
    keys = np.concatenate([keys[active] for keys, active in engine.seen])
    assert len(keys) == sum(sum(row["attempts"]) for row in rows)
    assert len(np.unique(keys, axis=0)) == len(keys)
    error = (trials.estimate_world - trials.hole_pos_world).reshape(-1, 2)
    apart = np.abs(error[:, None] - error).max(-1) + np.eye(len(error))
    assert apart.min() > 1e-6


def test_among_equals_the_tries_of_the_peg_in_hand_count_and_not_those_of_earlier_pegs():
    """A try in a broken world leaves a hole as good as it was, and only the tries tell it from its equals."""
    trials = scenarios.draw_trials(CONFIG, 0, np.arange(6))
    table = Table(CONFIG, methods.chosen("failure_only", methods.ASSEMBLY), trials, 0)
    seen = list(assembly.rounds(table, Breaking(), estimator.filter_update(CONFIG, None)))
    for row in range(6):
        peg, tries = -1, np.zeros(4, int)
        for one in (one for one in seen if one.before.active[row]):
            if one.before.peg[row] != peg:
                peg, tries = one.before.peg[row], np.zeros(4, int)
            belief = np.exp(one.before.beliefs.type_logp[row, :, trials.peg_type[row, peg]])
            open_ = np.where(one.before.filled[row], -1, belief)
            equals = np.flatnonzero(open_ >= open_.max() - 2e-6)
            assert one.chosen[row] == equals[tries[equals].argmin()]
            tries[one.chosen[row]] += 1


@pytest.mark.parametrize("revisit_from", ["belief", "detection"])
def test_a_peg_that_comes_back_to_a_hole_starts_where_the_configuration_says(revisit_from):
    """Other pegs start from what was learnt; the type always is what was learnt."""
    config = dataclasses.replace(CONFIG, task=dataclasses.replace(CONFIG.task, revisit_from=revisit_from))
    trials, rows = scenarios.draw_trials(config, 0, np.arange(6)), np.arange(6)
    table = Table(config, methods.chosen("full", methods.ASSEMBLY), trials, 0)
    learnt, tried_with, again, others = np.zeros((6, 4)), np.full((6, 4), -1), 0, 0

    def update(beliefs, felt, keys):
        moved = beliefs.pos_mean_world + np.array([0.03, 0], np.float32)
        logp = np.log(np.array([0.5, 0.3, 0.2], np.float32))
        return dataclasses.replace(beliefs, mean_world=moved, type_logp=np.tile(logp, (6, 1)))

    for tried in attempt_rounds(table.next_try, FakeEngine(), update, 2):
        hole, peg = table.choice.hole, np.minimum(table.pegs_done, 3)
        back = tried_with[rows, hole] == peg
        kept = np.where(back & (revisit_from == "detection"), 0, learnt[rows, hole])
        start = np.asarray(tried.asked.attempts.estimate_world)
        active = tried.asked.active
        np.testing.assert_allclose(
            (start - trials.estimate_world[rows, hole])[active, 0], kept[active], atol=1e-6
        )
        np.testing.assert_allclose(tried.asked.beliefs.pos_mean_world, start)
        first = np.exp(np.asarray(tried.asked.beliefs.type_logp))[:, 0]
        was_tried = tried_with[rows, hole] >= 0
        np.testing.assert_allclose(first[active & was_tried], 0.5, rtol=1e-5)
        again, others = again + (back & active).sum(), others + (was_tried & ~back & active).sum()
        failed = active & ~tried.rollouts.taken
        learnt[rows[failed], hole[failed]] = kept[failed] + 0.03
        tried_with[rows[active], hole[active]] = peg[active]
        table.learn(tried)
        table.record(tried)
    assert again > 5
    assert others > 5
