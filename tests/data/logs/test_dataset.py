"""Data sets of robots: what is written is what was felt, and what needs the truth is refused."""

import json
from dataclasses import replace

import h5py
import jax
import numpy as np
import pytest
import yaml
from robot_logs import map_of_table, recorded, table_of

import mjx_fit as mf
from mjx_fit.cli import main
from mjx_fit.data import hdf5_check_values, reader
from mjx_fit.data.episode import UNKNOWN
from mjx_fit.data.hdf5_fields import Kind
from mjx_fit.data.logs import import_log, read_map


@pytest.fixture(scope="module")
def folder(attempts, tmp_path_factory):
    """Two logs, their map, and the data set."""
    folder = tmp_path_factory.mktemp("logs")
    for name, some in (("one", attempts[:2]), ("two", attempts[2:])):
        table_of(recorded(some, noise_n=0.02)).to_csv(folder / f"{name}.csv", index=False)
    (folder / "map.yaml").write_text(yaml.safe_dump(map_of_table()))
    assert main.main(words(folder, folder / "data")) == 0
    return folder


def words(folder, out, *more):
    logs = [str(folder / f"{name}.csv") for name in ("one", "two")]
    return ["log", "import", *logs, "--map", str(folder / "map.yaml"), "--out", str(out), *more]


def test_the_data_set_holds_what_was_felt(folder, attempts):
    data = reader.load(folder / "data")
    said, config = read_map(folder / "map.yaml"), mf.Config()
    felt = [
        one.felt
        for name in ("one", "two")
        for one in import_log(folder / f"{name}.csv", said, config).attempts
    ]
    assert len(data.episode) == len(felt) == 3
    for i, one in enumerate(felt):
        n = int(one.length)
        there = jax.tree.map(lambda leaf, i=i: leaf[i], data.rollout.felt)
        assert there.length == n
        for name in ("wrench_sensor", "tip_pos_world", "tip_quat_world", "action_world"):
            np.testing.assert_array_equal(getattr(there.trace, name)[:n], getattr(one.trace, name))
        assert one.start is not None
        np.testing.assert_array_equal(there.start.pos_world, one.start.pos_world)
        np.testing.assert_array_equal(there.tare_sensor, one.tare_sensor)
        np.testing.assert_allclose(
            there.trace.tip_pos_world[:n], attempts[i].trace.tip_pos_world[:n], atol=1e-6
        )
    truth = data.rollout.truth
    assert (truth.hole_type == UNKNOWN).all()
    assert np.isnan(truth.hole_pos_world).all()


def test_a_sensor_reads_it_as_it_reads_the_logs(folder):
    """The posterior of the data set is that of the tracker, which has the log."""
    data, sensor = reader.load(folder / "data"), mf.load_sensor()
    said = read_map(folder / "map.yaml")
    (one, *_) = import_log(folder / "one.csv", said, mf.Config()).attempts
    felt = jax.tree.map(lambda leaf: leaf[0], data.rollout.felt)
    posteriors = []
    for measured in (felt, one.log):
        tracker = mf.BeliefTracker(sensor, np.asarray(felt.estimate_world)[None])
        tracker.choose("cross")
        posteriors.append(tracker.update(0, measured))
    np.testing.assert_allclose(posteriors[0].mean_world, posteriors[1].mean_world, atol=1e-6)
    np.testing.assert_allclose(posteriors[0].cov, posteriors[1].cov, atol=1e-9)


def test_commands_that_need_no_truth_take_it(folder, tmp_path, capsys):
    assert main.main(["data", "info", str(folder / "data"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["engine"] == told["policy"] == "robot"
    assert told["logs"] == {"one.csv": 2, "two.csv": 1}
    assert told["pegs"] == {"cross": 3}
    assert "success_rate" not in told
    assert main.main(["data", "check", str(folder / "data")]) == 0
    assert main.main(["data", "export", str(folder / "data"), "--out", str(tmp_path / "set.npz")]) == 0
    assert main.main(["data", "export", str(folder / "data"), "--out", str(tmp_path / "set.hdf5")]) == 0
    with np.load(tmp_path / "set.npz") as file:
        assert "hole_type" not in file
        assert file["start_pos_world"].shape == (3, 3)
    with h5py.File(tmp_path / "set.hdf5") as file:
        assert "hole_type" not in file["data/demo_0"].attrs
    assert main.main(["report", str(folder / "data"), "--out", str(tmp_path / "page")]) == 0
    page = (tmp_path / "page" / "index.html").read_text()
    assert "one.csv (2), two.csv (1)" in page
    assert "Coverage" not in page


def test_commands_that_need_it_refuse_it(folder, tmp_path, capsys):
    assert main.main(["train", "--data", str(folder / "data"), "--out", str(tmp_path / "run")]) == 2
    assert "it comes from logs of a robot" in capsys.readouterr().err


def test_the_same_logs_resume_and_others_are_refused(folder, tmp_path, capsys):
    assert main.main(words(folder, folder / "data")) == 0
    text = (folder / "two.csv").read_text()
    (tmp_path / "one.csv").write_text((folder / "one.csv").read_text())
    (tmp_path / "two.csv").write_text(text + "\n")
    (tmp_path / "map.yaml").write_text((folder / "map.yaml").read_text())
    assert main.main(words(tmp_path, folder / "data")) == 2
    assert "it holds another run (its logs differs" in capsys.readouterr().err
    said = yaml.safe_load((folder / "map.yaml").read_text())
    said["wrench"]["acts_on"] = "arm"
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(said))
    assert main.main(words(tmp_path, tmp_path / "data")) == 2
    assert "one.csv: refused: wrench: the arm pulls by" in capsys.readouterr().err
    assert not (tmp_path / "data").exists()


def test_a_simulated_shard_does_not_pass_for_a_robots(folder):
    """Types that nobody knows are a robot's alone."""
    data = reader.load(folder / "data")
    truth = replace(data.rollout.truth, hole_pos_world=np.zeros((3, 2), np.float32))
    simulated = replace(data, rollout=replace(data.rollout, truth=truth))
    with pytest.raises(ValueError, match="hole_type of episode 0: -1 is invalid: expected 0 to 2"):
        hdf5_check_values.require(simulated, 0, 1, types=3, policies=3)
    hdf5_check_values.require(data, 0, 1, types=3, policies=3, unknown=Kind(robot=True).unknown)
