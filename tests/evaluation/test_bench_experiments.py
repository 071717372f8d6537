"""Experiments on the bench, where poses are believed: what needs no sensor, from the command line."""

import json

import numpy as np
import pytest

from mjx_fit.cli.main import main

SHORT = ["--world", "bench", "--set", "task.attempt_actions=20", "--engine", "native"]


@pytest.mark.parametrize(
    "asked",
    [
        ["attempt", "--trials", "1"],
        ["position", "--methods", "oracle", "--trials", "1"],
        ["insertion", "--methods", "no_update,sample,oracle", "--trials", "1", "--seeds", "1"],
        ["assembly", "--methods", "failure_only,oracle", "--trials", "1", "--set", "task.max_attempts=2"],
    ],
    ids=lambda words: words[0],
)
def test_an_experiment_runs(asked, tmp_path, capsys):
    out = tmp_path / "result.json"
    assert main(["evaluate", *asked, *SHORT, "--out", str(out)]) == 0, capsys.readouterr().err
    result = json.loads(out.read_text())
    assert result["config"]["filter"]["coordinates"] == ["x", "y", "z", "yaw", "roll", "pitch"]
    if asked[0] == "position":
        trial = result["trials"][0]
        assert trial["degrees"] == 6
        # The oracle knows where the tool has to be.
        assert max(trial["error_cm"]) < 1e-4
        assert max(trial["turn_deg"]) < 1e-3
    if asked[0] == "attempt":
        assert np.all([0 < trial["error_m"] < 0.03 for trial in result["trials"]])
