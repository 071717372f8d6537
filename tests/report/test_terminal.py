"""Warnings next to numbers made outside the sensor's training conditions."""

from typing import Any

import pytest
from fakes import FakeEngine
from hypothesis import given
from hypothesis import strategies as st

from mjx_fit.cli import main
from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config, config_differences
from mjx_fit.evaluation import playback
from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.statistics import Row
from mjx_fit.report import terminal
from mjx_fit.sensors.trained_sensor import away_from_training
from mjx_fit.training.sensor_loader import TrainedSensor

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
    assert "training settings unknown" in said(capsys, sensor={"full": "f"})[0]
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
    assert bool(away_from_training(config_differences(Config(), read_config(None, [change])))) == is_said
    assert away_from_training(config_differences(Config(), Config())) == ""


def test_collecting_and_playing_away_from_the_training_say_so(capsys, monkeypatch):
    """Where no result is printed: the beliefs that attempts start from, and what is looked at."""
    network: Any = object()
    sensor, collecting = TrainedSensor(network, Config(), "f"), ["collect", "--run", "run", "--out", "d"]
    collecting += ["--episodes", "4", "--sequence", "2"]
    monkeypatch.setattr("mjx_fit.training.sensor_loader.load_trained_sensor", lambda run: sensor)
    monkeypatch.setattr("mjx_fit.task.estimator.filter_update", lambda config, sensor: None)
    monkeypatch.setattr("mjx_fit.data.collect.collect", lambda *_: None)
    monkeypatch.setattr("mjx_fit.data.collect.invalid_in", lambda *_: "")
    monkeypatch.setattr(playback, "draw_trials", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    away = ["--set", "scene.friction=0.6"]
    for options, is_away in ((away, True), ([], False)):
        assert main.main([*collecting, *options]) == 0
        config = read_config(None, options[1:])
        with pytest.raises(KeyboardInterrupt):
            playback.record(config, playback.Pick("full", 0), 0, FakeEngine(), sensor)
        line = "settings differ from the sensor's training: scene.friction is 0.3 there and 0.6 here"
        assert capsys.readouterr().err.splitlines() == [f"collect: {line}", f"playing: {line}"] * is_away
    assert main.main([*collecting, *away, "--sequence", "1"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
