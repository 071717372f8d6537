import json
from typing import Any

import h5py
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mjx_fit.config import Config, load
from mjx_fit.dataset import store
from mjx_fit.dataset.collect import collect, draw_attempts, pair_of
from mjx_fit.errors import RequestError
from mjx_fit.randomness import root_key

ASK: dict[str, Any] = {
    "episodes": 10,
    "steps": 3,
    "policy": "mixed",
    "engine": "native",
    "seed": 5,
    "batch": 5,
}


def files_of(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("data") / "set"
    collect(Config(), out, **ASK)
    return out


def test_pairs_are_balanced_and_half_matched():
    peg, hole = pair_of(np.arange(36))
    assert (peg == hole).mean() == 0.5
    counts = {(p, h): int(((peg == p) & (hole == h)).sum()) for p in range(3) for h in range(3)}
    assert {counts[p, p] for p in range(3)} == {6}
    assert {counts[p, h] for p in range(3) for h in range(3) if p != h} == {3}


def test_draws_depend_on_the_episode_alone():
    whole = draw_attempts(jax.random.key(3), jnp.arange(20), "mixed", Config().detector)
    part = draw_attempts(jax.random.key(3), jnp.asarray([11, 4]), "mixed", Config().detector)
    picked = jax.tree.map(lambda leaf: leaf[np.array([11, 4])], whole)
    for a, b in zip(jax.tree.leaves(part), jax.tree.leaves(picked), strict=True):
        assert (a == b).all()
    assert set(np.asarray(whole.policy).tolist()) == {0, 1}


def test_draws_tell_nothing_of_each_other():
    """The policy of an episode must not show where its hole is: a key used twice would be a leak."""
    n = 4000
    drawn = draw_attempts(root_key(0, "collect"), jnp.arange(n), "mixed", Config().detector)
    error = np.asarray(drawn.estimate_world - drawn.hole_pos_world)
    wiggle = np.asarray(jax.vmap(lambda key: jax.random.normal(jax.random.fold_in(key, 0), (3,)))(drawn.key))
    columns = np.column_stack([drawn.policy, error, drawn.hole_pos_world, wiggle, drawn.peg_type])
    correlation = np.corrcoef(columns, rowvar=False)
    assert np.abs(correlation - np.eye(len(correlation))).max() < 4.5 / np.sqrt(n)


def test_uses_of_one_seed_share_no_episode():
    collected = draw_attempts(root_key(0, "collect"), jnp.arange(50), "spiral", Config().detector)
    evaluated = draw_attempts(root_key(0, "attempt"), jnp.arange(50), "spiral", Config().detector)
    assert np.abs(np.asarray(collected.estimate_world - evaluated.estimate_world)).min(1).max() > 1e-4
    assert not (jax.random.key_data(collected.key) == jax.random.key_data(evaluated.key)).all(-1).any()


def test_every_field_has_unit_frame_and_meaning(folder):
    with h5py.File(folder / "shard-00000000.h5") as file:
        for name in store.FIELDS:
            assert {"unit", "frame", "meaning"} <= set(file[name].attrs)
        assert file["trace/wrench_sensor"].shape == (5, 3, 50, 6)
        assert np.asarray(file["episode"]).tolist() == [0, 1, 2, 3, 4]


def test_both_engines_store_the_same_schema(folder, tmp_path):
    collect(Config(), tmp_path / "mjx", **{**ASK, "episodes": 4, "steps": 2, "engine": "mjx"})
    assert store.describe(tmp_path / "mjx")["engine"] == "mjx"
    with h5py.File(folder / "shard-00000000.h5") as c, h5py.File(tmp_path / "mjx/shard-00000000.h5") as mjx:
        assert set(store.FIELDS) | {"episode", "trace"} >= set(mjx) == set(c)
        for name in store.FIELDS:
            assert mjx[name].dtype == c[name].dtype
            assert dict(mjx[name].attrs) == dict(c[name].attrs)
            assert mjx[name].shape[2:] == c[name].shape[2:]


def test_load_gives_the_episodes_in_order(folder):
    data = store.load(folder)
    peg, hole = pair_of(np.arange(10))
    assert np.array_equal(data.peg_type, peg)
    assert np.array_equal(data.hole_type, hole)
    error = np.abs(np.asarray(data.estimate_world) - np.asarray(data.hole_pos_world))
    assert 0 < error.max() <= 0.02 + 1e-6
    assert (np.asarray(data.length) == 3).all()


def test_describe_counts(folder):
    told = store.describe(folder)
    assert (told["episodes"], told["steps"], told["actions"]) == (10, 3, 30)
    assert (told["engine"], told["seed"], told["policy"]) == ("native", 5, "mixed")
    assert sum(pair["episodes"] for pair in told["pairs"].values()) == 10
    assert told["pairs"]["cross-cross"]["episodes"] == 2
    assert told["success_rate"] == {"matched": 0.0, "mismatched": 0.0}
    assert told["units"]["trace/tip_pos_world"] == "m"
    json.dumps(told)


def test_same_seed_same_bytes_and_a_repeat_changes_nothing(folder, tmp_path):
    collect(Config(), tmp_path / "again", **ASK)
    before = files_of(tmp_path / "again")
    assert before == files_of(folder)
    stamps = {path: path.stat().st_mtime_ns for path in folder.iterdir()}
    collect(Config(), folder, **ASK)
    assert stamps == {path: path.stat().st_mtime_ns for path in folder.iterdir()}


def test_killed_collection_goes_on_to_the_same_bytes(folder, tmp_path, monkeypatch):
    out = tmp_path / "killed"
    write = store.Writer.write

    def killed(self, name, episodes, interactions):
        if name != "shard-00000000.h5":
            raise KeyboardInterrupt
        write(self, name, episodes, interactions)

    with monkeypatch.context() as patch:
        patch.setattr(store.Writer, "write", killed)
        with pytest.raises(KeyboardInterrupt):
            collect(Config(), out, **ASK)
    assert not store.read_manifest(out)["complete"]
    (out / "shard-00000005.h5.tmp").write_bytes(b"torn")
    with pytest.raises(RequestError, match="it is not complete"):
        store.load(out)
    collect(Config(), out, **ASK)
    assert files_of(out) == files_of(folder)


def test_a_start_that_was_killed_at_once_can_be_repeated(folder, tmp_path):
    out = tmp_path / "begun"
    out.mkdir()
    (out / "manifest.json.tmp").write_text("{")
    collect(Config(), out, **ASK)
    assert files_of(out) == files_of(folder)


def test_damaged_shard_is_noticed_and_made_again(folder, tmp_path):
    out = tmp_path / "damaged"
    collect(Config(), out, **ASK)
    shard = out / "shard-00000005.h5"
    content = bytearray(shard.read_bytes())
    content[len(content) // 2] ^= 1
    shard.write_bytes(content)
    with pytest.raises(RequestError, match=r"shard-00000005\.h5 .* SHA-256"):
        store.load(out)
    collect(Config(), out, **ASK)
    assert files_of(out) == files_of(folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"episodes": -3}, "--episodes: -3 is not allowed: it must be at least 1"),
        ({"steps": 0}, "--steps: 0 is not allowed"),
        ({"policy": "zigzag"}, "--policy: 'zigzag' is not allowed: it must be one of spiral, random, mixed"),
        ({"seed": -1}, "--seed: -1 is not allowed"),
        ({"batch": 0}, "--batch: 0 is not allowed"),
        ({"engine": "warp9"}, "--engine: 'warp9' is not allowed"),
    ],
)
def test_bad_requests_are_refused_before_anything_is_written(change: dict[str, Any], message, tmp_path):
    with pytest.raises(RequestError, match=message):
        collect(Config(), tmp_path / "new", **{**ASK, **change})
    assert not (tmp_path / "new").exists()


def test_folder_of_another_run_is_refused_and_untouched(folder, tmp_path):
    before = files_of(folder)
    with pytest.raises(RequestError, match=r"holds another run .its seed differs: 5 there, 6 here"):
        collect(Config(), folder, **{**ASK, "seed": 6})
    with pytest.raises(RequestError, match=r"holds another run .its config differs"):
        collect(load(None, ["scene.friction=0.2"]), folder, **ASK)
    assert files_of(folder) == before
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(RequestError, match="holds other files"):
        collect(Config(), tmp_path, **ASK)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_missing_or_damaged_data_is_one_line(folder, tmp_path):
    with pytest.raises(RequestError, match="there is no such folder"):
        store.load(tmp_path / "nowhere")
    with pytest.raises(RequestError, match="it is no data set"):
        store.load(tmp_path)
    (tmp_path / "manifest.json").write_text("{")
    with pytest.raises(RequestError, match="cannot be read"):
        store.load(tmp_path)
    manifest = json.loads((folder / "manifest.json").read_text())
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    (tmp_path / "shard-00000000.h5").write_bytes((folder / "shard-00000000.h5").read_bytes()[:1000])
    with pytest.raises(RequestError, match=r"shard-00000000\.h5 .* damaged or missing"):
        store.load(tmp_path)
