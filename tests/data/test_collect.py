"""Content of collected data sets."""

import shutil
from dataclasses import replace
from typing import Any

import h5py
import jax
import numpy as np
import pytest
from collecting import Collector, files_of
from fakes import FakeEngine, Peeking
from synthetic import with_truth

from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config
from mjx_fit.config.worlds import world_file
from mjx_fit.control.policies import SPIRAL
from mjx_fit.data import hdf5_fields, reader
from mjx_fit.data.manifest import read_manifest, write_manifest
from mjx_fit.data.merge import merge
from mjx_fit.data.plan import Plan, plan_of
from mjx_fit.data.schedule import pair_of, policy_of
from mjx_fit.data.sequences import Sequences
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.utils.errors import RequestError

CONFIG = Config()


@pytest.fixture(scope="module")
def folder(collect, tmp_path_factory):
    return collect(tmp_path_factory.mktemp("data") / "set")


def test_one_trace_can_be_read_alone(folder):
    with h5py.File(folder / "shard-00000000.h5") as file:
        wrench: Any = file["trace/wrench_sensor"]
        assert wrench.chunks == (1, 3, 50, 6)


def test_every_field_has_unit_frame_shape_and_meaning(folder):
    sizes = {"n": 5, "J": 3, "joints": 7}
    with h5py.File(folder / "shard-00000000.h5") as file:
        for name in hdf5_fields.FIELDS:
            about, data = file[name].attrs, file[name]
            assert {"unit", "frame", "meaning"} <= set(about)
            said = about["shape"].split()
            assert data.shape == tuple(sizes.get(axis) or int(axis) for axis in said)
        assert np.asarray(file["episode"]).tolist() == [0, 1, 2, 3, 4]
        assert np.asarray(file.attrs["shapes"]).tolist() == ["cross", "rectangle", "square"]


def test_load_gives_the_episodes_in_order(folder):
    data = reader.load(folder)
    assert data.episode.tolist() == data.sequence.tolist() == list(range(10))
    peg, hole = pair_of(np.arange(10), 3)
    done = data.rollout
    assert np.array_equal(done.felt.peg_type, peg)
    assert np.array_equal(done.truth.hole_type, hole)
    error = np.abs(np.asarray(done.felt.estimate_world) - np.asarray(done.truth.hole_pos_world))
    assert 0 < error.max() <= 0.02 + 1e-6
    assert (done.felt.length == 3).all()
    assert np.allclose(data.estimate_cov, 1e-4 * np.eye(2))


def test_describe_counts(folder):
    told = reader.describe(folder)
    assert (told["episodes"], told["steps"], told["actions"]) == (10, 3, 30)
    assert (told["engine"], told["seed"], told["policy"]) == ("native", 5, "mixed")
    assert sum(pair["episodes"] for pair in told["pairs"].values()) == 10
    assert told["pairs"]["cross-cross"]["episodes"] == 2
    assert told["success_rate"] == {"matched": 0.0, "mismatched": 0.0}
    assert told["units"]["trace/tip_pos_world"] == "m"
    assert told["bytes"] == sum(path.stat().st_size for path in folder.glob("*.h5"))


def test_sequences_keep_their_hole_and_end_with_an_insertion(collect, tmp_path):
    """Easy holes and narrow estimates, so that pegs do go in."""
    easy = read_config(None, ["scene.clearance_m=0.003", "sequence.max_std_m=0.001", "spiral.push_m=0.008"])
    easily = Collector(NativeEngine(easy, 2))
    plan = {"episodes": 36, "sequence": 3, "actions": 30, "policy": "spiral", "batch": 6}
    data = reader.load(easily(tmp_path / "easy", easy, **plan))
    done = data.rollout
    assert data.episode.tolist() == list(range(36))
    assert data.sequence.tolist() == [i // 3 for i in range(36)]
    assert data.number.tolist() == [i % 3 for i in range(36)]
    assert set(data.policy.tolist()) == {SPIRAL}
    rows = np.arange(36).reshape(12, 3)
    for name in ("peg_type", "hole_type", "hole_pos_world"):
        value = getattr(done.felt if name == "peg_type" else done.truth, name)[rows]
        assert (value == value[:, :1]).all()
    assert len(np.unique(done.felt.estimate_world, axis=0)) == 36
    inserted, happened = done.truth.inserted[rows], (done.felt.length > 0)[rows]
    assert np.array_equal(happened[:, 1:], np.cumsum(inserted, 1)[:, :-1] == 0)
    assert inserted[:, 0].sum() + inserted[:, 1].sum() > 0
    assert not happened.all()
    assert not np.abs(done.felt.trace.wrench_sensor[~happened.ravel()]).any()
    assert np.allclose(data.estimate_cov[0], 1e-4 * np.eye(2))
    assert np.linalg.det(data.estimate_cov[1]) <= (1e-6 * 1.01) ** 2
    told = reader.describe(tmp_path / "easy")
    assert told["not_performed"] == int((~happened).sum())
    assert told["sequences"] == 12
    # The same whatever the batch.
    again = reader.load(easily(tmp_path / "other", easy, **{**plan, "batch": 5}))
    assert np.array_equal(again.rollout.felt.trace.wrench_sensor, done.felt.trace.wrench_sensor)


def test_a_spiral_is_as_long_as_an_attempt(collect, tmp_path):
    """Twice the steps must not make it a slower spiral: it is to be what the robot does later."""
    config = read_config(None, ["task.attempt_actions=4"])
    data = reader.load(collect(tmp_path / "long", config, episodes=24, batch=24, actions=6)).rollout
    short = reader.load(collect(tmp_path / "short", config, episodes=24, batch=24, actions=4)).rollout
    # Fewer steps are the beginning of it, and not a spiral in a hurry.
    cut = reader.load(collect(tmp_path / "cut", config, episodes=24, batch=24, actions=2)).rollout
    spiral = policy_of("mixed", np.arange(24), 0, 3) == SPIRAL
    assert np.array_equal(reader.load(tmp_path / "long").policy == SPIRAL, spiral)
    assert spiral.sum() == 12
    assert (data.felt.length == np.where(spiral, 4, 6)).all()
    assert np.array_equal(data.felt.trace.wrench_sensor[spiral, :4], short.felt.trace.wrench_sensor[spiral])
    assert not data.felt.trace.wrench_sensor[spiral, 4:].any()
    assert np.array_equal(data.felt.trace.action_world[spiral, :2], cut.felt.trace.action_world[spiral])
    assert np.array_equal(data.felt.trace.wrench_sensor[spiral, :2], cut.felt.trace.wrench_sensor[spiral])


def test_parts_merge_into_what_one_machine_makes(collect, tmp_path):
    plan = {"episodes": 22, "sequence": 2, "batch": 6}
    whole = collect(tmp_path / "whole", **plan)
    parts = [collect(tmp_path / f"part{i}", **plan, shard_index=i, num_shards=3) for i in range(3)]
    assert sum(len(list(part.glob("*.h5"))) for part in parts) == len(list(whole.glob("*.h5"))) == 4
    merge(parts[::-1], tmp_path / "merged")
    assert files_of(tmp_path / "merged") == files_of(whole)
    stamps = {path: path.stat().st_mtime_ns for path in (tmp_path / "merged").iterdir()}
    merge(parts, tmp_path / "merged")
    assert stamps == {path: path.stat().st_mtime_ns for path in (tmp_path / "merged").iterdir()}
    assert len(reader.load(parts[0]).episode) == 10  # a part is a data set, too

    for given, message in (
        (parts[:2], "part 2 of 3 is missing"),
        ([parts[0], whole], "it is a part of 1"),
        (
            [*parts, collect(tmp_path / "odd", **{**plan, "seed": 1})],
            r"not a part of the same data set .*seed",
        ),
    ):
        with pytest.raises(RequestError, match=message):
            merge(given, tmp_path / "refused")
    assert not (tmp_path / "refused").exists()
    damaged = parts[1] / sorted(path.name for path in parts[1].glob("*.h5"))[0]
    damaged.write_bytes(damaged.read_bytes()[:-1])
    with pytest.raises(RequestError, match=f"{damaged.name} .* is damaged"):
        merge(parts, tmp_path / "fresh")
    collect(parts[1], **plan, shard_index=1, num_shards=3)
    merge(parts, tmp_path / "fresh")
    assert files_of(tmp_path / "fresh") == files_of(whole)


def test_later_attempts_start_from_what_a_sensor_believes(native, tmp_path):
    """A sensor that halves the error each time, and knows that it does."""
    seen, engine = [], Peeking(native)
    collect = Collector(engine)

    def update(beliefs, felt, keys):
        seen.append(jax.random.key_data(keys))
        error = engine.truth.hole_pos_world - beliefs.pos_mean_world
        return replace(beliefs, mean_world=beliefs.mean_world + error / 2, cov=beliefs.cov / 4)

    plan: dict[str, Any] = {"episodes": 12, "sequence": 3, "policy": "spiral", "sensor": "halving"}
    data = reader.load(collect(tmp_path / "own", update=update, **plan))
    rows = np.arange(12).reshape(4, 3)
    estimate, hole = data.rollout.felt.estimate_world[rows], data.rollout.truth.hole_pos_world[rows]
    error = estimate - hole
    np.testing.assert_allclose(error[:, 1], error[:, 0] / 2, atol=1e-7)
    np.testing.assert_allclose(error[:, 2], error[:, 0] / 4, atol=1e-7)
    cov = data.estimate_cov[rows]
    np.testing.assert_allclose(cov[:, 2], np.broadcast_to(1e-4 / 16 * np.eye(2), (4, 2, 2)), rtol=1e-5)
    assert len(np.unique(np.concatenate(seen), axis=0)) == sum(len(keys) for keys in seen)
    for sensor in ("another", ""):
        with pytest.raises(RequestError, match="its sensor differs"):
            collect(tmp_path / "own", **{**plan, "sensor": sensor})
    with pytest.raises(RequestError, match="--run cannot be used with --sequence 1"):
        collect(tmp_path / "one", **{**plan, "sequence": 1})
    wide = read_config(None, ["detector.half_width_m=0.03"])
    with pytest.raises(RequestError, match=r"plate_half_width_m: 0.08 .* random.reach_m and half a peg"):
        collect(tmp_path / "wide", wide, policy="random")


def test_the_engine_is_the_one_that_the_plan_names(collect, tmp_path):
    with pytest.raises(RequestError, match="--engine: mjx does not match the engine native"):
        collect(tmp_path / "new", engine="mjx")
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"episodes": -3}, "--episodes: -3 is out of range: expected 1 to"),
        (
            {"episodes": 10, "sequence": 3},
            "--episodes: 10 is invalid: expected a multiple",
        ),
        ({"actions": 0}, "--actions: 0 is out of range"),
        ({"policy": "zigzag"}, "--policy: 'zigzag' is invalid: expected one of spiral, random, mixed"),
        ({"seed": -1}, "--seed: -1 is out of range"),
        ({"batch": 0}, "--batch: 0 is out of range"),
        ({"sequence": 0}, "--sequence: 0 is out of range"),
        ({"engine": "warp9"}, "--engine: 'warp9' is invalid"),
        ({"shard_index": 2, "num_shards": 2}, "--shard-index: 2 is out of range: expected 0 to 1"),
        ({"num_shards": 0}, "--num-shards: 0 is out of range"),
        ({"num_shards": 9}, "--num-shards: 9 is invalid: expected at most 2"),
        ({"episodes": 10**11}, "--episodes: 100000000000 is out of range: expected 1 to 10000000"),
        ({"num_shards": 9, "shard_index": 8}, "--num-shards: 9 is invalid: expected at most 2"),
    ],
)
def test_bad_requests_write_nothing(change: dict[str, Any], message, collect, tmp_path):
    with pytest.raises(RequestError, match=message):
        collect(tmp_path / "new", **change)
    assert not (tmp_path / "new").exists()


def test_a_data_set_of_an_older_version_is_its_own(folder, collect, tmp_path):
    """Its configuration lacks keys that were added since; they have the values of that time."""
    older = tmp_path / "older"
    shutil.copytree(folder, older)
    manifest = read_manifest(older)
    then = world_file("as-2026-11")
    config = plan_of(manifest).request(read_config(then))["config"]
    config["scene"] = {name: value for name, value in config["scene"].items() if name != "slip_time_s"}
    del config["pose"]
    write_manifest(older, replace(manifest, request=manifest.request | {"config": config}))
    before = files_of(older)
    collect(older, read_config(then))
    assert files_of(older) == before
    with pytest.raises(RequestError, match=r"its config differs: scene.friction is 0.3 there and 0.2 here"):
        collect(older, read_config(then, ["scene.friction=0.2"]))


def test_folder_of_another_run_is_refused_and_untouched(folder, collect, tmp_path):
    before = files_of(folder)
    with pytest.raises(RequestError, match=r"holds another run .its seed differs: 5 there, 6 here"):
        collect(folder, seed=6)
    with pytest.raises(RequestError, match=r"its config differs: scene.friction is 0.3 there and 0.2 here"):
        collect(folder, read_config(None, ["scene.friction=0.2"]))
    with pytest.raises(RequestError, match=r"holds another run .its part differs"):
        collect(folder, num_shards=2)
    assert files_of(folder) == before
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(RequestError, match="holds other files"):
        collect(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_how_a_sensor_is_built_and_trained_makes_no_other_data(folder, collect):
    before = files_of(folder)
    collect(folder, read_config(None, ["sensor.noise=trace", "train.epochs=7"]))
    assert files_of(folder) == before


def test_what_other_versions_began_is_not_continued(collect, tmp_path):
    out = collect(tmp_path / "old")
    there = read_manifest(out)
    write_manifest(out, replace(there, versions=there.versions | {"jax": "0.1"}))
    collect(out)  # complete: there is nothing to do
    (out / "shard-00000005.h5").unlink()
    with pytest.raises(RequestError, match=r"begun with jax 0\.1, and here is"):
        collect(out)
    assert not (out / "shard-00000005.h5").exists()


def test_a_sequence_ends_with_a_world_that_broke(tmp_path, capsys):
    """What was believed after it is of no attempt, so that nothing begins from there."""

    class Breaking(FakeEngine):
        def run(self, attempts, actions=None, active=None, horizon=None):
            done = super().run(attempts, actions, active, horizon)
            broken = (len(self.seen) == 2) & (np.arange(len(done.felt.length)) == 1)
            return with_truth(done, valid=~broken, inserted=np.zeros(len(broken), bool))

    engine = Breaking()
    plan = Plan(episodes=9, actions=2, policy="random", seed=0, batch=9, sequence=3)
    sequences = Sequences(engine, Config(), plan, tmp_path, None)
    data = sequences(0)
    assert [active.tolist() for _, active in engine.seen] == [[True] * 3, [True] * 3, [True, False, True]]
    assert data.rollout.truth.valid.tolist() == [i != 4 for i in range(9)]
    assert (data.rollout.felt.length > 0).tolist() == [i != 5 for i in range(9)]
    assert "episode 4: " in capsys.readouterr().err


@pytest.mark.parametrize("revisit_from", ["belief", "detection"])
def test_later_attempts_start_where_revisits_do(revisit_from, tmp_path):
    """An estimator that moves each belief by 1 cm: later attempts follow it, or begin where the first did."""

    def moved(beliefs, felt, keys):
        return replace(beliefs, mean_world=beliefs.mean_world + 0.01)

    engine, config = FakeEngine(), read_config(None, [f"task.revisit_from={revisit_from}"])
    plan = Plan(episodes=9, actions=2, policy="spiral", seed=0, batch=9, sequence=3)
    Sequences(engine, config, plan, tmp_path, moved)(0)
    off = [np.asarray(start) - engine.starts[0] for start in engine.starts[1:]]
    expected = (0.01, 0.02) if revisit_from == "belief" else (0, 0)
    for one, distance in zip(off, expected, strict=True):
        np.testing.assert_allclose(one, distance, atol=1e-6)
