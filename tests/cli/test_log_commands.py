"""``log check``: what it says of good and damaged logs, and its exit codes."""

import sys

import jax
import numpy as np
import pytest
import yaml

import mjx_fit as mf
from mjx_fit.cli import main
from mjx_fit.sensors.pose import start_of

COLUMNS = ["time", "fx", "fy", "fz", "tx", "ty", "tz", "x", "y", "z", "qw", "qx", "qy", "qz"]


@pytest.fixture(scope="module")
def rows():
    """One attempt at 500 Hz in every column, after half a second of rest."""
    felt = mf.make_engine("native").run(mf.draw_attempts(jax.random.key(0), 1), actions=40).felt[0]
    wrench = np.asarray(felt.trace.wrench_sensor, float).reshape(-1, 6)
    start = start_of(felt, mf.Config())
    at = np.concatenate([[start.pos_world], felt.trace.tip_pos_world])
    turn = np.concatenate([[start.quat_world], felt.trace.tip_quat_world])
    times, known = 0.002 * np.arange(len(wrench)), 0.1 * np.arange(len(at))
    pose = np.column_stack([np.interp(times, known, column) for column in np.hstack([at, turn]).T])
    rest = np.column_stack([np.tile(felt.tare_sensor, (250, 1)), np.tile(pose[0], (250, 1))])
    values = np.vstack([rest, np.hstack([wrench, pose])])
    noise = np.random.default_rng(0).normal(0, 0.01, (len(values), 6))
    values[:, :6] += noise * [1, 1, 1, 0.01, 0.01, 0.01]
    return np.column_stack([5 + 0.002 * np.arange(len(values)), values])


def checked(folder, rows, **wrench):
    said = {
        "wrench": {"source": COLUMNS[1:7], "acts_on": "peg", "sensor_in_tool": {"position_m": [0, 0, -0.07]}},
        "pose": {"source": COLUMNS[7:], "rotation": "quat_wxyz"},
        "attempts": {"peg": "cross"},
    }
    said["wrench"] |= wrench
    (folder / "map.yaml").write_text(yaml.safe_dump(said))
    np.savetxt(folder / "log.csv", rows, delimiter=",", header=",".join(COLUMNS), comments="")
    return main.main(["log", "check", str(folder / "log.csv"), "--map", str(folder / "map.yaml")])


def test_a_good_log_lists_its_attempts(rows, tmp_path, capsys):
    assert checked(tmp_path, rows) == 0
    said = capsys.readouterr().out
    assert "log.csv: attempt 0: 5." in said
    assert "log.csv: 1 attempts can be used" in said
    assert "refused" not in said


def test_a_log_that_cannot_be_used_is_told_with_its_cause(rows, tmp_path, capsys):
    assert checked(tmp_path, rows, acts_on="arm") == 1
    said = capsys.readouterr()
    assert "log.csv: refused: wrench: the arm pulls by" in said.out
    assert said.err == "mjx-fit: log.csv: cannot be used: see above\n"


def test_without_the_extra_it_says_what_to_install(rows, tmp_path, capsys, monkeypatch):
    monkeypatch.delitem(sys.modules, "mjx_fit.data.logs.sources.tables", raising=False)
    monkeypatch.setitem(sys.modules, "pandas", None)
    assert checked(tmp_path, rows) == 2
    assert "pip install 'mjx-fit[logs]'" in capsys.readouterr().err
