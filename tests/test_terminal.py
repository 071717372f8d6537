"""What is said beside numbers that were made away from where the sensor was trained."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjx_fit import commands
from mjx_fit.config import Config, differences, load
from mjx_fit.evaluation import recording
from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.statistics import Row
from mjx_fit.report import terminal
from mjx_fit.training.kinship import away_from_training

EXPERIMENTS = ("position", "insertion", "assembly", "calibration")


def said(capsys, experiment="position", **request) -> list[str]:
    """The lines below the table."""
    row = Row("full", "success_rate", "all", 0.5, 0.4, 0.6, 10)
    terminal.print_summary(Result(experiment, {}, 0, "native", "cpu", {}, [row], [], request))
    lines = capsys.readouterr().out.splitlines()
    return lines[next(i for i, line in enumerate(lines) if line.startswith("└")) + 1 :]


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_a_result_away_from_its_sensors_training_says_so(experiment, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")  # a line stays one, however narrow the terminal
    differs = ["scene.friction is 0.3 there and 0.6 here", "wrist.force_noise_n is 0.1 there and 0.2 here"]
    line = f"settings differ from the sensor's training: {differs[0]}"
    assert said(capsys, experiment, sensor="f", differs_from_training=differs[:1]) == [line]
    assert said(capsys, experiment, sensor="f", differs_from_training=differs) == [f"{line} (and 1 more)"]
    assert said(capsys, experiment, sensor="f", differs_from_training=[]) == []


def test_what_is_not_known_is_said_and_without_a_sensor_nothing_is(capsys):
    assert "is not known" in said(capsys, sensor={"full": "f"})[0]
    requests: list[dict] = [
        {},
        {"sensor": None},
        {"sensor": {}},
        {"sensor": None, "differs_from_training": []},
    ]
    for request in requests:
        assert said(capsys, **request) == []


@given(st.lists(st.text(), max_size=4))
def test_it_is_one_line_whatever_a_result_says(differs):
    assert "\n" not in away_from_training(differs)


@pytest.mark.parametrize(
    ("change", "is_said"),
    [
        ("scene.friction=0.6", True),
        ("task.max_attempts=2", True),
        ("sensor.width=16", False),
        ("train.epochs=3", False),
    ],
)
def test_settings_of_the_network_are_the_runs_own(change, is_said):
    assert bool(away_from_training(differences(Config(), load(None, [change])))) == is_said
    assert away_from_training(differences(Config(), Config())) == ""


def test_collecting_and_playing_away_from_the_training_say_so(capsys, monkeypatch):
    """Where no result is printed: the beliefs that attempts start from, and what is looked at."""
    away = load(None, ["scene.friction=0.6"])
    monkeypatch.setattr("mjx_fit.training.checkpoint.load_sensor", lambda run: (object(), Config()))
    monkeypatch.setattr("mjx_fit.training.checkpoint.fingerprint_of", lambda sensor: "f")
    monkeypatch.setattr("mjx_fit.task.learning.filter_update", lambda config, sensor: None)
    monkeypatch.setattr(recording, "draw_trials", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    monkeypatch.setattr(recording, "make_engine", lambda name, config: None)
    for config, is_away in ((away, True), (Config(), False)):
        commands._update(config, Path("run"))
        with pytest.raises(KeyboardInterrupt):
            recording.record(config, Path("run"), "full", 0, 0)
        line = "settings differ from the sensor's training: scene.friction is 0.3 there and 0.6 here"
        assert capsys.readouterr().err.splitlines() == [f"collect: {line}", f"playing: {line}"] * is_away
