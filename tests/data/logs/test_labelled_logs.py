"""Logs with labels: beliefs are scored by them, and nothing of them gets into a belief."""

import json

import jax
import numpy as np
import pandas
import pytest
import yaml
from robot_logs import map_of_table, recorded, table_of

import mjx_fit as mf
from mjx_fit.cli import main
from mjx_fit.data import reader
from mjx_fit.evaluation.scores import squared_mahalanobis

PLACES = np.array([[0.5, 0.01], [0.5, 0.011], [0.52, 0.0]])
HOLES, INSERTED = ["square", "rectangle", "square"], [False, False, True]


@pytest.fixture(scope="module")
def folder(attempts, tmp_path_factory):
    """A log of three attempts: labels of holes when they begin, outcomes 0.3 s after they end."""
    folder = tmp_path_factory.mktemp("labelled")
    own = recorded(attempts, noise_n=0.02)
    begins, ends = np.array(own.attempts).T
    labels = pandas.DataFrame(
        {"time": begins - 0.2, "hole": HOLES, "hole_x": PLACES[:, 0], "hole_y": PLACES[:, 1]}
    )
    outcomes = pandas.DataFrame({"time": ends + 0.3, "in": [str(one) for one in INSERTED]})
    rows = pandas.concat([table_of(own), labels, outcomes]).sort_values("time", kind="stable")
    rows.to_csv(folder / "log.csv", index=False)
    (folder / "map.yaml").write_text(yaml.safe_dump(map_of_table() | {"truth": truth()}))
    assert import_with(folder, folder / "map.yaml", folder / "data") == 0
    return folder


def truth():
    return {"hole_source": "hole", "place_source": ["hole_x", "hole_y"], "inserted_source": "in"}


def import_with(folder, said, out):
    return main.main(["log", "import", str(folder / "log.csv"), "--map", str(said), "--out", str(out)])


def test_labels_are_the_truth_of_the_data_set(folder, capsys):
    truth = reader.load(folder / "data").rollout.truth
    np.testing.assert_allclose(truth.hole_pos_world, PLACES, rtol=1e-6)
    assert [mf.Config().scene.names[one] for one in truth.hole_type] == HOLES
    assert truth.inserted.tolist() == INSERTED
    assert np.isnan(truth.end_qpos).all()
    assert main.main(["data", "info", str(folder / "data"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["pairs"]["cross-square"] == {"episodes": 2, "inserted": 0, "inserted_wrongly": 1}
    assert told["pegs"] == {"cross": 3}


def test_measurements_are_those_without_labels(folder, tmp_path):
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(map_of_table()))
    assert import_with(folder, tmp_path / "map.yaml", tmp_path / "data") == 0
    with_, without = (reader.load(one / "data").rollout.felt for one in (folder, tmp_path))
    jax.tree.map(np.testing.assert_array_equal, with_, without)


def test_evaluation_scores_the_belief_of_the_tracker(folder, tmp_path):
    """The oracle is the online path: its posterior of the failed attempts, without noise of a simulation."""
    out = tmp_path / "scores.json"
    assert main.main(["evaluate", "calibration", "--data", str(folder / "data"), "--out", str(out)]) == 0
    result = json.loads(out.read_text())
    assert result["engine"] == "robot"
    rows = [row for row in result["trials"] if row["method"] == "full"]
    assert [row["trial"] for row in rows] == [0, 1]
    assert [row["pair"] for row in rows] == [["cross", "square"], ["cross", "rectangle"]]
    data, sensor = reader.load(folder / "data"), mf.load_sensor()
    for i, row in enumerate(rows):
        felt = jax.tree.map(lambda leaf, i=i: leaf[i], data.rollout.felt)
        tracker = mf.BeliefTracker(sensor, np.asarray(felt.estimate_world)[None])
        tracker.choose("cross")
        belief = tracker.update(0, felt)
        error = PLACES[i] - np.asarray(belief.mean_world)
        np.testing.assert_allclose(row["error_cm"], 100 * np.linalg.norm(error), rtol=1e-3)
        squared = squared_mahalanobis(error[None], np.asarray(belief.cov)[None])[0]
        np.testing.assert_allclose(row["squared_mahalanobis"], squared, rtol=1e-3)
        np.testing.assert_allclose(row["type_probability"], np.exp(belief.type_logp), atol=2e-3)


def test_a_sensor_can_be_trained_on_them_too(folder, tmp_path):
    from mjx_fit.data.joined import load_joined

    alone = load_joined([folder / "data"])
    assert alone.rollout.felt.start is None
    np.testing.assert_allclose(alone.rollout.truth.hole_pos_world, PLACES, rtol=1e-6)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"hole": "square"}, "truth.hole: expected either hole or hole_source"),
        ({"inserted_source": None}, "truth.inserted: expected either inserted or inserted_source"),
        ({"hole_source": "in"}, "in: 'False' is invalid: expected one of cross, rectangle, square"),
        ({"inserted_source": "hole"}, "hole: 'square' is invalid: expected 0, 1, false or true"),
        ({"place_source": ["hole_x"]}, "place: 1 values are invalid: expected x and y"),
    ],
)
def test_what_is_wrong_is_said(change, expected, folder, tmp_path, capsys):
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(map_of_table() | {"truth": truth() | change}))
    assert import_with(folder, tmp_path / "map.yaml", tmp_path / "data") == 2
    error = capsys.readouterr().err
    assert expected in error
    assert error.count("\n") == 1
    assert not (tmp_path / "data").exists()


def test_an_outcome_that_is_missing_is_not_the_next_ones(folder, tmp_path, capsys):
    rows = pandas.read_csv(folder / "log.csv", dtype={"in": str})
    said = np.flatnonzero(rows["in"].notna())
    assert len(said) == 3
    rows.drop(index=said[1]).to_csv(tmp_path / "log.csv", index=False)
    assert import_with(tmp_path, folder / "map.yaml", tmp_path / "data") == 0
    assert "attempt 1: no outcome is said from" in capsys.readouterr().out
    assert reader.load(tmp_path / "data").rollout.truth.inserted.tolist() == [False, True]
