"""Attempts in a row at one hole, with fake physics, and the experiments built from them."""

import shutil
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from fakes import CLOSE_M, FakeEngine, T, halving, make_holes
from faults import Faults, Killed
from synthetic import with_trace, with_truth

from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config
from mjx_fit.config.worlds import world_file
from mjx_fit.evaluation import insertion, parts, position, result_file, results
from mjx_fit.evaluation.request import Request
from mjx_fit.filters.updates import initial_belief
from mjx_fit.jobs.pool import Here
from mjx_fit.task import estimator, methods, single_hole
from mjx_fit.task.after_attempts import after_failures
from mjx_fit.task.holes import Holes
from mjx_fit.training.sensor_loader import load_baseline, load_trained_sensor
from mjx_fit.types import Attempt, Observation
from mjx_fit.utils import resources

CONFIG = Config()


def play(picked, holes, engine, max_attempts=5):
    return tried(picked, holes, max_attempts, engine, {"full": halving})


def tried(picked, holes, max_attempts, engine, updates, config=CONFIG):
    table = single_hole.HoleTable(config, picked, holes, max_attempts)
    for _ in single_hole.rounds(table, engine, single_hole.update_of_rows(picked, updates)):
        pass
    return table.outcomes()


def test_it_goes_on_until_the_peg_is_in_and_the_belief_stays_from_there_on():
    holes, engine = make_holes(), FakeEngine()
    done = play((methods.INSERTION[0],), holes, engine)["full"]
    error = np.linalg.norm(holes.estimate_world - holes.hole_pos_world, axis=1)
    for i in range(T):
        halved = error[i] * 0.5 ** np.arange(6)
        first = np.flatnonzero(halved[:5] < CLOSE_M)
        inserted_at = first[0] + 1 if i < T // 2 and len(first) else 0
        assert done.inserted_at[i] == inserted_at
        assert done.attempts[i] == (inserted_at or 5)
        updates = np.minimum(np.arange(6), inserted_at - 1 if inserted_at else 5)
        got = np.linalg.norm(done.mean_world[i] - holes.hole_pos_world[i], axis=1)
        np.testing.assert_allclose(got, error[i] * 0.5**updates, rtol=1e-3, atol=1e-6)
        np.testing.assert_allclose(done.cov[i, :, 0, 0], 1e-4 * 0.25**updates, rtol=1e-5)
        assert np.isfinite(done.effort.peak_force_n[i]).sum() == done.attempts[i]
    for number, (_, active) in enumerate(engine.seen):
        assert np.array_equal(active, (done.inserted_at == 0) | (done.inserted_at > number))


def test_attempts_may_all_start_from_the_detection():
    holes, engine = make_holes(), FakeEngine()
    config = replace(CONFIG, task=replace(CONFIG.task, revisit_from="detection"))
    done = tried((methods.INSERTION[0],), holes, 3, engine, {"full": halving}, config)["full"]
    far = np.linalg.norm(holes.estimate_world - holes.hole_pos_world, axis=1) > CLOSE_M
    for start in engine.starts:
        np.testing.assert_array_equal(start[far], holes.estimate_world[far])
    once = np.broadcast_to([1e-4, 0.25e-4, 0.25e-4, 0.25e-4], (far.sum(), 4))
    np.testing.assert_allclose(done.cov[far, :, 0, 0], once, rtol=1e-5)


def test_methods_share_their_draws_and_differ_in_where_they_start():
    holes, engine = make_holes(), FakeEngine()
    done = play(methods.INSERTION, holes, engine)
    assert list(done) == ["full", "position_only", "no_update", "sample", "frame_by_frame", "oracle"]
    for keys, _ in engine.seen:
        by_method = keys.reshape(6, T, -1)
        assert (by_method == by_method[0]).all()
    assert len(np.unique(np.concatenate([keys for keys, _ in engine.seen]), axis=0)) == T * len(engine.seen)
    starts = np.stack(engine.starts).reshape(len(engine.seen), 6, T, 2)
    assert (starts[:, 2] == holes.estimate_world).all()
    np.testing.assert_array_equal(starts[0, 5], holes.hole_pos_world)
    # Samples of N(μ0, (1 cm)² I), a new one each time.
    offset = (starts[:, 3] - holes.estimate_world).reshape(-1, 2)
    assert np.cov(offset.T) == pytest.approx(1e-4 * np.eye(2), abs=3e-5)
    assert len(np.unique(offset, axis=0)) == len(offset)
    assert (done["oracle"].inserted_at[: T // 2] == 1).all()
    assert (done["no_update"].mean_world == holes.estimate_world[:, None]).all()


def test_a_trials_outcome_does_not_depend_on_its_batch():
    holes = make_holes()
    some = np.array([3, 7, 30])
    arrays = {name: leaf for name, leaf in vars(holes).items() if name != "physics"}
    few = Holes(**{name: leaf[some] for name, leaf in arrays.items()})
    whole, part = (play(methods.INSERTION, world, FakeEngine())["sample"] for world in (holes, few))
    assert np.array_equal(whole.inserted_at[some], part.inserted_at)


def asked(tmp_path, **changes) -> tuple[Path, result_file.Header]:
    return tmp_path / "r.json", result_file.header("position", CONFIG, 0, "native", {"trials": 5} | changes)


def in_parts(asked, n, work, seen=None):
    """Work in n parts, each given its number; ``seen`` gets the number of rows after each new one."""

    def told(rows, done, text):
        if seen is not None:
            seen.append(len(rows))

    out, here = asked
    return parts.in_parts(out, here, range(n), lambda part, _: work(part), told, Here())


def test_a_result_of_an_older_version_is_its_own(tmp_path):
    """Its configuration lacks keys that were added since; they have the values of that time."""
    then = read_config(world_file("as-2026-11"))
    out, here = tmp_path / "r.json", result_file.header("position", then, 0, "native", {"trials": 5})
    written = result_file.write(out, here, [], [])
    older = dict(
        written.config, scene={k: v for k, v in written.config["scene"].items() if k != "slip_time_s"}
    )
    older.pop("pose")
    results.write(out, replace(written, config=older))
    assert result_file.finished(out, here) is not None
    with pytest.raises(result_file.RequestError, match="holds another result"):
        result_file.finished(out, here | {"seed": 1})


def test_parts_that_are_killed_at_any_file_operation_go_on(tmp_path, monkeypatch):
    """From the first temporary file on, to the same result file and nothing else."""

    def evaluate(out):
        _, here = asked(tmp_path)

        def work():
            rows = in_parts((out, here), 2, lambda part: [{"trial": part}])
            assert rows == [{"trial": 0}, {"trial": 1}]
            return result_file.write(out, here, [], [])

        result_file.once(out, here, work)
        parts.finish(out)
        return {path.name: path.read_bytes() for path in out.parent.iterdir()}

    whole, moment = evaluate(tmp_path / "whole" / "r.json")["r.json"], 0
    while True:
        out = tmp_path / f"killed{moment}" / "r.json"
        with monkeypatch.context() as patch:
            faults = Faults(patch, out.parent, moment)
            with suppress(Killed):
                evaluate(out)
        if not faults.failed:
            break
        left = evaluate(out)
        assert left.pop("r.json") == whole
        assert set(left) <= {"r.json.lock"}  # its holder was killed once all was done
        moment += 1
    assert moment > 30


def test_work_that_is_killed_goes_on_with_the_part_that_it_was_in(tmp_path):
    worked = []

    def work(part, kill_at=None):
        if part == kill_at:
            raise KeyboardInterrupt
        worked.append(part)
        return [{"trial": part, "value": 2 * part}]

    with pytest.raises(KeyboardInterrupt):
        in_parts(asked(tmp_path), 4, lambda part: work(part, kill_at=2))
    seen = []
    rows = in_parts(asked(tmp_path), 4, work, seen)
    assert worked == [0, 1, 2, 3]
    assert [row["value"] for row in rows] == [0, 2, 4, 6]
    assert seen == [2, 3, 4]
    damaged = tmp_path / "r.parts" / "part-00001.json"
    damaged.write_text(damaged.read_text()[:-3])
    assert in_parts(asked(tmp_path), 4, work) == rows
    assert worked == [0, 1, 2, 3, 1]
    with pytest.raises(result_file.RequestError, match="its request differs"):
        in_parts(asked(tmp_path, trials=6), 4, work)
    parts.finish(tmp_path / "r.json")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "r.parts").mkdir()
    (tmp_path / "r.parts" / "mine.txt").write_text("keep")
    with pytest.raises(result_file.RequestError, match="it holds other files"):
        in_parts(asked(tmp_path), 4, work)


@pytest.mark.parametrize(("n", "methods_", "sizes"), [(100, 3, [100]), (750, 5, [188] * 4)])
def test_pieces_hold_every_trial_once_and_have_one_shape(n, methods_, sizes):
    found = parts.pieces(n, methods_, "native", Config())
    assert [len(piece) for piece in found] == sizes
    assert np.concatenate(found)[:n].tolist() == list(range(n))
    assert len(found[-1]) - (sum(sizes) - n) > 0
    slow = replace(Config(), filter=replace(Config().filter, reads="geometry"))
    fewer = parts.pieces(n, methods_, "native", slow)
    assert max(len(piece) for piece in fewer) * methods_ <= 64
    assert np.concatenate(fewer)[:n].tolist() == list(range(n))


class Says:
    """A sensor that says the same of every reading."""

    def __init__(self, innovation):
        self.innovation = innovation

    def __call__(self, reading):
        n = reading.mask.shape[0]
        return Observation(
            innovation=jnp.broadcast_to(jnp.asarray(self.innovation), (n, 2)),
            pos_noise_cov=jnp.broadcast_to(4e-6 * jnp.eye(2), (n, 2, 2)),
            match_logits=jnp.zeros((n, 2)),
            match_model_logp=jnp.zeros((n, 3, 2)),
        )


def test_frame_by_frame_takes_what_was_seen_from_where_the_attempt_started(monkeypatch):
    """Not from what is believed, which it forgets; and only of attempts that failed."""
    monkeypatch.setattr(estimator.nnx, "split", lambda sensor: (sensor, {}))
    monkeypatch.setattr(estimator.nnx, "merge", lambda sensor, state: sensor)
    holes = make_holes()
    start = np.where(np.arange(T)[:, None] < 5, holes.hole_pos_world, holes.estimate_world + 0.001)
    attempts = Attempt(
        jnp.asarray(holes.peg_type), jnp.asarray(holes.hole_type), jnp.asarray(holes.hole_pos_world),
        jnp.asarray(start), jnp.zeros(T, int), holes.key,
    )  # fmt: skip
    done = FakeEngine().run(attempts, 2)
    beliefs = initial_belief(jnp.asarray(holes.estimate_world), 0.01, 3)
    sensor: Any = Says([0.002, -0.003])
    update = estimator.frame_update(CONFIG, sensor)
    after = after_failures(update, beliefs, done, holes.key)
    failed = ~np.asarray(done.truth.inserted)
    assert 0 < failed.sum() < T
    want = np.where(failed[:, None], start + np.array([0.002, -0.003]), holes.estimate_world)
    np.testing.assert_allclose(after.pos_mean_world, want, atol=1e-7)
    assert np.asarray(after.pos_cov[:, 0, 0]) == pytest.approx(np.where(failed, 4e-6, 1e-4))
    np.testing.assert_array_equal(after.type_logp, beliefs.type_logp)


def test_trials_of_position_and_insertion_are_what_they_are_said_to_be(tmp_path):
    """Pairs in turn, an oracle that knows, seeds of a draw that share hole and estimate, refusals."""
    run, engine = resources.folder("weights"), FakeEngine()
    sensor, baseline = load_trained_sensor(run), load_baseline(run)
    base = Request(CONFIG, tmp_path / "p.json", engine, 12, 3, sensor=sensor, baseline=baseline)
    found = position.position(replace(base, methods="oracle"))
    pairs = [tuple(trial["pair"]) for trial in found.trials]
    assert len({pair for pair in pairs[:12] if pair[0] != pair[1]}) == 6
    assert all(peg == hole for peg, hole in pairs[12:])
    assert all(trial["error_cm"] == [0] * 6 for trial in found.trials)
    assert {trial["inserted_at"] for trial in found.trials[12:]} == {1}
    assert {trial["inserted_at"] for trial in found.trials[:12]} == {None}

    engine = FakeEngine()
    asked_for = replace(base, out=tmp_path / "i.json", engine=engine, trials=9, methods="no_update,sample")
    found = insertion.insertion(replace(asked_for, seeds=4))
    assert len(found.trials) == 2 * 9 * 4
    starts = engine.starts[0].reshape(2, 9, 4, 2)
    assert (starts[0] == starts[0][:, :1]).all()
    assert len(np.unique(starts[1].reshape(-1, 2), axis=0)) == 36
    first = {trial["trial"]: trial["success"] for trial in found.trials if trial["method"] == "no_update"}
    error = {}
    for trial in found.trials:
        if trial["method"] == "no_update":
            assert trial["success"] == first[trial["trial"]]
            error[trial["trial"]] = trial["shape"]
    assert [error[draw] for draw in range(9)] == ["cross", "rectangle", "square"] * 3
    with pytest.raises(result_file.RequestError, match="it holds another result"):
        insertion.insertion(replace(asked_for, seeds=5))
    seen = len(engine.seen)
    assert insertion.insertion(replace(asked_for, seeds=4)).trials == found.trials
    assert len(engine.seen) == seen  # it is recognised, and nothing is simulated
    bare = tmp_path / "bare"
    shutil.copytree(run, bare, ignore=shutil.ignore_patterns("frame_by_frame"))
    without = replace(base, out=tmp_path / "q.json", trials=2, baseline=load_baseline(bare))
    with pytest.raises(
        result_file.RequestError, match="the run lacks frame_by_frame, which method 'frame_by_frame' needs"
    ):
        position.position(replace(without, methods="full,frame_by_frame"))
    with pytest.raises(result_file.RequestError, match="--run is required: method 'full' needs"):
        position.position(replace(without, methods="full", sensor=None))
    wide = read_config(None, ["scene.clearance_m=0.002"])
    found = position.position(replace(base, config=wide, out=tmp_path / "w.json", trials=2, methods="oracle"))
    assert found.request["differs_from_training"] == []


def test_what_position_trials_come_to():
    def trial(number, matched, errors, inserted_at):
        pair = ("cross", "cross") if matched else ("cross", "square")
        zeros = [1.0] * 6
        return {"trial": number, "method": "full", "pair": pair, "error_cm": errors,
                "squared_mahalanobis": zeros, "inserted_at": inserted_at}  # fmt: skip

    trials = [
        trial(0, False, [2.0, 1.0, 0.5, 0.4, 0.3, 0.2], None),
        trial(1, False, [1.0, 0.0, 0.5, 0.2, 0.1, 0.0], None),
        trial(2, True, [1.0, 0.4, 0.4, 0.4, 0.4, 0.4], 2),
        trial(3, True, [1.0, 0.2, 0.1, 0.1, 0.1, 0.1], None),
    ]
    rows = {(row.metric, row.group): row for row in position.summarise(trials)}
    assert rows["position_error_cm", "1"].value == pytest.approx(0.5)
    assert rows["position_error_cm", "matched:5"].value == pytest.approx(0.25)
    assert rows["position_error_cm", "left:1"].value == pytest.approx(0.3)
    assert (rows["position_error_cm", "left:2"].value, rows["position_error_cm", "left:2"].n) == (0.1, 1)
    assert [rows["coverage_90", str(k)].n for k in range(4)] == [4, 4, 3, 3]


def test_what_insertion_trials_come_to():
    def trial(draw, seed, method, attempts, success):
        return {"trial": draw, "seed": seed, "method": method, "shape": "cross", "attempts": attempts,
                "success": success, "peak_force_n": [30.0]}  # fmt: skip

    broken = trial(0, 0, "full", 10, False) | {"peak_force_n": [None]}
    assert all(np.isfinite(row.value) for row in insertion.summarise([broken]))
    trials = []
    for draw in range(30):
        for seed in range(2):
            trials.append(trial(draw, seed, "full", 1 + draw % 2, True))
            trials.append(trial(draw, seed, "no_update", 10 if draw % 3 else 4, draw % 3 == 0))
            trials.append(trial(draw, seed, "sample", 1 + (draw + seed) % 2, True))
    rows = {(row.method, row.metric, row.group): row for row in insertion.summarise(trials[::-1])}
    assert rows["full", "success_rate", "1"].value == pytest.approx(0.5)
    assert rows["full", "success_rate", "2"].value == 1
    assert rows["full", "success_rate", "2"].low == pytest.approx(0.886, abs=0.001)  # Wilson's for 30 of 30
    assert rows["no_update", "attempts", "all"].value == pytest.approx((4 + 11 + 11) / 3)
    saved = np.mean([(11 if draw % 3 else 4) - 1 - draw % 2 for draw in range(30)])
    assert rows["full", "attempts_saved", "no_update"].value == pytest.approx(saved)
    assert rows["full", "p_value", "no_update"].value < 0.001
    assert rows["full", "attempts_saved", "sample"].value == pytest.approx(0)
    assert rows["full", "p_value", "sample"].value == 1


def test_nees_and_coverage_of_position_trials():
    """Squared distances by hand; per dimension one half, and no score for an oracle, which is certain."""
    squared = [[2.0] * 6, [4.0] * 6, [8.0] * 6]
    trials = [
        {"trial": i, "method": method, "pair": ("cross", "square"), "error_cm": [1.0] * 6,
         "squared_mahalanobis": of, "inserted_at": None}
        for method in ("full", "oracle") for i, of in enumerate(squared)
    ]  # fmt: skip
    rows = {(row.method, row.metric, row.group): row.value for row in position.summarise(trials)}
    assert rows["full", "nees", "3"] == pytest.approx(14 / 3 / 2)
    assert rows["full", "coverage_50", "3"] == 0  # 1.386
    assert rows["full", "coverage_90", "3"] == pytest.approx(2 / 3)  # 4.605
    assert ("oracle", "nees", "3") not in rows


def test_the_peak_force_of_an_insertion_is_the_largest_of_its_attempts():
    trials = [
        {"trial": i, "seed": 0, "method": "full", "shape": "cross", "attempts": 3, "success": True,
         "peak_force_n": force}
        for i, force in enumerate([[30.0, 50.0, None], [20.0, 10.0, 15.0]])
    ]  # fmt: skip
    rows = {(row.metric, row.group): row for row in insertion.summarise(trials)}
    assert rows["peak_force_n", "all"].value == pytest.approx((50 + 20) / 2)
    assert rows["peak_force_n", "median"].value == 20


class Breaking(FakeEngine):
    """Every other world breaks in the first round, wherever its peg ended."""

    def run(self, attempts, actions=None, active=None, horizon=None):
        done = super().run(attempts, actions, active, horizon)
        broken = (len(self.seen) == 1) & (np.arange(len(done.felt.length)) % 2 == 0)
        nothing = np.where(broken[:, None, None, None], np.nan, np.zeros((1, 1, 50, 6)))
        done = with_trace(done, wrench_sensor=done.felt.trace.wrench_sensor + nothing)
        return with_truth(done, valid=~broken, inserted=np.zeros(len(broken), bool))


def test_no_method_learns_from_a_broken_world(monkeypatch):
    """By the filter or frame by frame: what was believed stays, while the world beside it teaches."""
    monkeypatch.setattr(estimator.nnx, "split", lambda sensor: (sensor, {}))
    monkeypatch.setattr(estimator.nnx, "merge", lambda sensor, state: sensor)
    sensor: Any = Says([0.002, -0.003])
    picked = tuple(one for one in methods.POSITION if one.reads)
    updates = {
        "full": estimator.filter_update(CONFIG, sensor),
        "position_only": estimator.position_update(CONFIG, sensor),
        "frame_by_frame": estimator.frame_update(CONFIG, sensor),
    }
    holes = make_holes()
    found = tried(picked, holes, 2, Breaking(), updates)
    for done in found.values():
        moved = np.abs(np.diff(done.mean_world, axis=1)).max(-1) > 1e-5
        assert moved[:, 0].tolist() == [False, True] * (T // 2)
        assert np.array_equal(np.diff(done.cov, axis=1)[::2, 0], np.zeros((T // 2, 2, 2)))
        assert np.isfinite(done.mean_world).all()
        assert np.isfinite(done.cov).all()
    assert (found["full"].mean_world[::2, 2] != found["full"].mean_world[::2, 1]).any()
