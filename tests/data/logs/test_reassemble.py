"""The script for REASSEMBLE on a small file of the same layout, made from simulated attempts."""

import importlib.util
import json
from dataclasses import replace

import h5py
import jax
import numpy as np
import pytest
from places import ROOT
from robot_logs import recorded

import mjx_fit as mf
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.sensors.pose import start_of

CONFIG = mf.Config()
BOARD_M = 0.231


@pytest.fixture(scope="module")
def script():
    path = ROOT / "experiments/real/reassemble.py"
    spec = importlib.util.spec_from_file_location("reassemble", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def insertions(attempts):
    """Two failed attempts, and two at places that are known exactly."""
    drawn = mf.draw_attempts(jax.random.key(5), 4)
    own = jax.tree.map(lambda leaf: leaf[::2], drawn)
    felt = mf.make_engine("native").run(replace(own, estimate_world=own.hole_pos_world))
    assert np.asarray(felt.truth.inserted).all()
    rows = [jax.tree.map(lambda leaf, i=i: np.asarray(leaf)[i], felt.felt) for i in range(2)]
    return [*attempts[:2], *(replace(row, start=start_of(row, CONFIG)) for row in rows)]


@pytest.fixture(scope="module")
def recording(insertions, tmp_path_factory):
    """A recording of the data set's layout: the wrench acts on the arm, and heights count from the base."""
    folder = tmp_path_factory.mktemp("reassemble")
    own = recorded(insertions, noise_n=0.02)
    path = folder / "2025-01-09-13-59-54.h5"
    with h5py.File(path, "w") as file:
        state, times = file.create_group("robot_state"), file.create_group("timestamps")
        pose = own.pose[:, 1:].copy()
        pose[:, 2] += BOARD_M - plate_top_m(CONFIG.scene)
        for name, values, time in (
            ("measured_force", -own.wrench[:, 1:4], own.wrench[:, 0]),
            ("measured_torque", -own.wrench[:, 4:], own.wrench[:, 0]),
            ("pose", pose, own.pose[:, 0]),
        ):
            state[name], times[name] = values, time[:, None]
        said = [("Pick round peg 1.", True, own.attempts[0][0] - 1.1, own.attempts[0][0] - 0.7)]
        said += [(f"Insert round peg {i}.", i >= 2, *span) for i, span in enumerate(own.attempts)]
        for number, (text, success, begin, end) in enumerate(said):
            one = file.create_group(f"segments_info/{number}")
            one["start"], one["end"], one["success"], one["text"] = begin, end, success, text
    poses = {"NIST_Board1": [[0.5, 0.0, BOARD_M], [0, 0, 0, 1]]}
    path.with_name(f"{path.stem}_poses.json").write_text(json.dumps(poses))
    return path


def test_its_insertions_are_imported_drawn_and_scored(script, recording, insertions, tmp_path):
    script.main([recording], script.MAP, tmp_path)
    told = json.loads((tmp_path / "scores.json").read_text())
    rows = told["recordings"][recording.name]["insertions"]
    assert [row["segment"] for row in rows] == [1, 2, 3, 4]
    assert [row["labelled"] for row in rows] == [False, False, True, True]
    assert [row["sensed"] for row in rows] == [False, False, True, True]
    assert (told["right"], told["of"]) == (4, 4)
    assert (tmp_path / f"{recording.stem}.png").stat().st_size > 10_000

    log = script.import_log(
        tmp_path / f"{recording.stem}.npz", script.read_map(tmp_path / f"{recording.stem}.yaml"), CONFIG
    )
    assert not log.refused
    for one, want in zip(log.attempts, insertions, strict=True):
        n = int(min(one.felt.length, want.length))
        new, old = (
            np.asarray(each.trace.wrench_sensor)[:n] - np.asarray(each.tare_sensor)
            for each in (one.felt, want)
        )
        np.testing.assert_allclose(new, old, atol=0.1)
        heights = [np.asarray(each.trace.tip_pos_world)[:n, 2] for each in (one.felt, want)]
        np.testing.assert_allclose(heights[0], heights[1], atol=1e-5)


def test_a_recording_without_the_board_is_refused_in_one_line(script, recording, tmp_path):
    alone = tmp_path / recording.name
    alone.write_bytes(recording.read_bytes())
    script.main([alone], script.MAP, tmp_path)
    (said,) = json.loads((tmp_path / "scores.json").read_text())["recordings"][alone.name]["findings"]
    assert "2025-01-09-13-59-54_poses.json is missing" in said


def test_what_it_cannot_read_costs_that_recording_alone(script, recording, tmp_path, capsys):
    """Torques have a clock of their own; a recording without insertions is said and left out."""
    halved, empty = tmp_path / recording.name, tmp_path / "2025-01-09-14-00-00.h5"
    halved.write_bytes(recording.read_bytes())
    empty.write_bytes(recording.read_bytes())
    poses = recording.with_name(f"{recording.stem}_poses.json").read_text()
    for path in (halved, empty):
        path.with_name(f"{path.stem}_poses.json").write_text(poses)
    with h5py.File(halved, "a") as file:
        for group in ("robot_state", "timestamps"):
            rows = script.values(file, f"{group}/measured_torque")[::2]
            del file[f"{group}/measured_torque"]
            file[f"{group}/measured_torque"] = rows
    with h5py.File(empty, "a") as file:
        for number in range(1, 5):
            del file[f"segments_info/{number}"]
    script.main([empty, halved, tmp_path / "missing.h5"], script.MAP, tmp_path / "out")
    told = json.loads((tmp_path / "out" / "scores.json").read_text())["recordings"]
    assert "no segment is an insertion" in told[empty.name]["findings"][0]
    assert told["missing.h5"]["findings"][0].startswith("refused: ")
    assert [row["sensed"] for row in told[halved.name]["insertions"]] == [False, False, True, True]
    log = script.import_log(
        tmp_path / "out" / f"{halved.stem}.npz",
        script.read_map(tmp_path / "out" / f"{halved.stem}.yaml"),
        CONFIG,
    )
    assert not log.refused
