"""A simulated data set goes out to MCAP and LeRobot, comes back as logs of a robot, and says the same."""

import json
import shutil

import jax
import numpy as np
import pytest
import yaml
from collecting import Collector
from pyarrow import parquet

import mjx_fit as mf
from mjx_fit.cli import main
from mjx_fit.data import reader
from mjx_fit.data.exports import export, frames

EQUAL = 1e-5


@pytest.fixture(scope="module")
def folder(native, tmp_path_factory):
    """Whole attempts, some of which end early."""
    folder = tmp_path_factory.mktemp("round") / "set"
    return Collector(native)(folder, actions=100, policy="spiral", episodes=8)


@pytest.fixture(scope="module")
def lerobot(folder):
    out = folder.with_name("as_lerobot")
    assert main.main(["data", "export", str(folder), "--out", str(out)]) == 0
    return out


def imported(log, said, out, capsys):
    assert main.main(["log", "import", str(log), "--map", str(said), "--out", str(out)]) == 0
    assert "left out" not in capsys.readouterr().out  # what is between attempts is none
    return reader.load(out)


def posteriors(felt):
    """The posterior of the shipped sensor after each attempt."""
    sensor, found = mf.load_sensor(), []
    for i in range(len(felt.length)):
        one = jax.tree.map(lambda leaf, i=i: np.asarray(leaf[i]), felt)
        tracker = mf.BeliefTracker(sensor, np.asarray(one.estimate_world)[None])
        tracker.choose(mf.Config().scene.names[int(one.peg_type)])
        found.append(tracker.update(0, one))
    return found


def require_same(data, again):
    felt, back = data.rollout.felt, again.rollout.felt
    np.testing.assert_array_equal(back.length, felt.length)
    assert len(set(felt.length.tolist())) > 1
    np.testing.assert_array_equal(back.peg_type, felt.peg_type)
    assert len(set(felt.peg_type.tolist())) > 1
    truth, told = data.rollout.truth, again.rollout.truth
    for name in ("hole_type", "inserted", "hole_pos_world"):
        np.testing.assert_array_equal(getattr(told, name), getattr(truth, name))
    assert 0 < truth.inserted.sum() < len(truth.inserted)
    for one, other in zip(posteriors(felt), posteriors(back), strict=True):
        for name in ("mean_world", "cov", "type_logp"):
            np.testing.assert_allclose(getattr(other, name), getattr(one, name), rtol=EQUAL, atol=1e-9)


def test_mcap_gives_the_same_posteriors(folder, tmp_path, capsys):
    log = tmp_path / "set.mcap"
    assert main.main(["data", "export", str(folder), "--out", str(log)]) == 0
    again = imported(log, tmp_path / "set.map.yaml", tmp_path / "again", capsys)
    require_same(reader.load(folder), again)


def test_lerobot_gives_the_same_posteriors(folder, lerobot, tmp_path, capsys):
    require_same(reader.load(folder), imported(lerobot, lerobot / "map.yaml", tmp_path / "again", capsys))


def test_the_statistics_are_those_of_the_frames(folder, lerobot):
    table = parquet.read_table(lerobot / "data").to_pydict()
    told = json.loads((lerobot / "meta/stats.json").read_text())
    length = reader.load(folder).rollout.felt.length
    assert len(table["index"]) == (length + 1).sum() == told["index"]["count"][0]
    for name in (frames.STATE, frames.WINDOW, frames.ACTION, "timestamp", "next.success"):
        values = np.array(table[name], float)
        values = values[:, None] if values.ndim == 1 else values
        for what, expected in (("min", values.min(0)), ("max", values.max(0)), ("mean", values.mean(0))):
            np.testing.assert_allclose(told[name][what], expected, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(told[name]["std"], values.std(0), rtol=1e-4, atol=1e-7)
    episodes = parquet.read_table(lerobot / "meta/episodes").to_pydict()
    assert episodes["length"] == (length + 1).tolist()
    assert episodes["dataset_to_index"][-1] == len(table["index"])
    own = np.array(table["episode_index"]) == 3
    wrench = np.array(table[frames.WINDOW])[own]
    np.testing.assert_allclose(episodes[f"stats/{frames.WINDOW}/max"][3], wrench.max(0), rtol=1e-6)


def test_frames_are_what_came_before_their_actions(folder, lerobot):
    table = parquet.read_table(lerobot / "data").to_pydict()
    felt = reader.load(folder).rollout.felt
    own, n = np.array(table["episode_index"]) == 1, int(felt.length[1])
    wrench, action = np.array(table[frames.WINDOW])[own], np.array(table[frames.ACTION])[own]
    np.testing.assert_array_equal(wrench[0], np.tile(felt.tare_sensor[1], (50, 1)))
    np.testing.assert_array_equal(wrench[1:].astype(np.float32), felt.trace.wrench_sensor[1, :n])
    np.testing.assert_array_equal(action[:-1].astype(np.float32), felt.trace.action_world[1, :n])
    assert not action[-1].any()


def test_a_folder_that_is_there_stays(folder, lerobot, capsys):
    before = sorted(path.name for path in lerobot.rglob("*"))
    assert main.main(["data", "export", str(folder), "--out", str(lerobot)]) == 2
    assert "it exists; remove it or name another" in capsys.readouterr().err
    assert sorted(path.name for path in lerobot.rglob("*")) == before


def test_what_fails_leaves_nothing(folder, tmp_path, monkeypatch):
    def fails(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("mjx_fit.data.exports.lerobot.parquet.write_table", fails)
    with pytest.raises(OSError, match="No space"):
        export(folder, tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir() if not path.name.endswith(".lock")] == []


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda said, _: said["wrench"].update(source="observation.force"), "'observation.force' is missing"),
        (lambda said, _: said["pose"].update(source="observation.state"), "13 values are invalid"),
        (
            lambda said, _: said["pose"].update(source=["observation.state:x", "observation.state:up"]),
            "observation.state has no element 'up': expected x, y, z",
        ),
        (lambda said, _: said["attempts"].update(peg="cross"), "peg_source: it cannot be used with peg"),
        (lambda _, info: info.update(codebase_version="v2.1"), "version 'v2.1' is invalid: expected v3"),
        (lambda _, info: info.update(fps=0), "fps: 0 is invalid"),
    ],
)
def test_what_does_not_fit_is_said(change, expected, lerobot, tmp_path, capsys):
    copy = tmp_path / "copy"
    shutil.copytree(lerobot, copy)
    said = yaml.safe_load((copy / "map.yaml").read_text())
    info = json.loads((copy / "meta/info.json").read_text())
    change(said, info)
    (copy / "map.yaml").write_text(yaml.safe_dump(said))
    (copy / "meta/info.json").write_text(json.dumps(info))
    words = ["log", "check", str(copy), "--map", str(copy / "map.yaml")]
    assert main.main(words) == 2
    assert expected in capsys.readouterr().err


def test_episodes_may_be_told_apart_by_a_text(lerobot, tmp_path, capsys):
    """Two episodes in a row with the same peg are two attempts, and what follows the last frame is none."""
    said = yaml.safe_load((lerobot / "map.yaml").read_text())
    said["attempts"]["source"] = frames.PEG
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(said))
    again = imported(lerobot, tmp_path / "map.yaml", tmp_path / "again", capsys)
    assert len(again.episode) == len(parquet.read_table(lerobot / "meta/episodes"))


def test_damaged_folders_are_refused(lerobot, tmp_path, capsys):
    def truncated(copy):
        file = next((copy / "data").rglob("*.parquet"))
        file.write_bytes(file.read_bytes()[:5000])

    def emptied(copy):
        for file in (copy / "data").rglob("*.parquet"):
            parquet.write_table(parquet.read_table(file)[:0], file)

    def without(copy):
        shutil.rmtree(copy / "data")

    def untold(copy):
        (copy / "meta/info.json").write_text("{")

    for damage in (truncated, emptied, without, untold):
        copy = tmp_path / damage.__name__
        shutil.copytree(lerobot, copy)
        damage(copy)
        assert main.main(["log", "check", str(copy), "--map", str(lerobot / "map.yaml")]) == 2
        told = capsys.readouterr().err
        assert told.count("\n") == 1
        assert "cannot be" in told


def test_an_empty_folder_may_be_filled(folder, tmp_path):
    (tmp_path / "out").mkdir()
    export(folder, tmp_path / "out")
    assert (tmp_path / "out/meta/info.json").exists()
