"""Whether a sensor may be judged, or trained, on a data set."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config
from mjx_fit.config.sections.shape import SHAPES, Shape
from mjx_fit.data import reader
from mjx_fit.data.joined import load_joined
from mjx_fit.data.manifest import read_manifest
from mjx_fit.training import compatibility
from mjx_fit.training.run import Run
from mjx_fit.training.sensor_loader import TrainedSensor
from mjx_fit.training.train import train_from
from mjx_fit.utils import provenance
from mjx_fit.utils.errors import RequestError


@pytest.fixture(scope="module")
def folder(collect, tmp_path_factory):
    return collect(tmp_path_factory.mktemp("kin") / "set")


@pytest.fixture
def run(folder, tmp_path):
    """A run folder that says what it was trained on."""
    data = reader.load(folder)
    told = {"data": provenance.fingerprint(data), "first_hole": compatibility.first_holes(data)[0]}
    (tmp_path / "run.json").write_text(json.dumps(told))
    return tmp_path


def judge(run, data):
    compatibility.require_new(run, data, provenance.fingerprint(data))


def test_the_data_of_the_training_are_refused(run, folder):
    with pytest.raises(RequestError, match="data that the run was trained on cannot be used"):
        judge(run, reader.load(folder))


def test_the_holes_of_the_training_are_refused_however_many(run, collect, tmp_path):
    more = reader.load(collect(tmp_path / "more", episodes=7))
    with pytest.raises(RequestError, match="holes that the run was trained at cannot be used"):
        judge(run, more)


def test_other_holes_are_new(run, collect, tmp_path):
    judge(run, reader.load(collect(tmp_path / "other", seed=6)))


def test_data_of_another_world_are_refused(folder, tmp_path):
    for key, value in (("scene.clearance_m", 0.002), ("control.kp_position", 500.0)):
        config = read_config(None, [f"{key}={value}"])
        with pytest.raises(RequestError, match=rf"--data: .*{key} is .* there and {value:g} here"):
            train_from([folder], config, Run(tmp_path / "run", seed=0))
    assert not (tmp_path / "run").exists()
    request = read_manifest(folder).request
    for other in ("wrist.force_noise_n=0.2", "scene.max_contacts=8"):  # neither is a property of the world
        compatibility.require_world(request, read_config(None, [other]))
    with pytest.raises(RequestError, match=r"scene\.max_contacts is 24 there and 8 here"):
        compatibility.require_world({**request, "engine": "mjx"}, read_config(None, ["scene.max_contacts=8"]))


def test_data_of_other_shapes_are_refused(collect, tmp_path):
    folder = collect(tmp_path / "set")
    bar = Shape("bar", SHAPES[0].rectangles)
    config = replace(Config(), scene=replace(Config().scene, shapes=(bar, *SHAPES[1:])))
    with pytest.raises(RequestError, match=r"--data: .*scene.shapes is .*cross.* there and .*bar.* here"):
        train_from([folder], config, Run(tmp_path / "run", seed=0))
    assert not (tmp_path / "run").exists()


def test_a_sensor_of_other_shapes_is_refused_wherever_it_is_used():
    bar = Shape("bar", SHAPES[0].rectangles)
    config = replace(Config(), scene=replace(Config().scene, shapes=(bar, *SHAPES[1:])))
    network: Any = object()
    with pytest.raises(
        RequestError, match=r"--run: .* cross, rectangle, square there and bar, rectangle, square here"
    ):
        TrainedSensor(network, Config(), "f").adapt(config)


def test_a_quantity_of_the_data_is_in_the_range_of_the_configuration(folder):
    request = read_manifest(folder).request
    wider = read_config(None, ["randomize.friction={uniform: [0.2, 0.6]}"])
    compatibility.require_world(request, wider)
    away = read_config(None, ["randomize.friction={uniform: [0.4, 0.6]}"])
    with pytest.raises(RequestError, match=r"scene\.friction is 0\.3 there and 0\.4 to 0\.6 here"):
        compatibility.require_world(request, away)
    scaled = read_config(None, ["randomize.part_scale={choice: [0.9, 1.1]}"])
    compatibility.require_world(request, scaled)


def test_several_data_sets_are_joined_and_all_their_holes_are_known(folder, collect, tmp_path):
    second = collect(tmp_path / "second", seed=6)
    joined = load_joined([folder, second])
    parts = [reader.load(one) for one in (folder, second)]
    assert len(joined.episode) == sum(len(part.episode) for part in parts)
    assert len(np.unique(joined.episode)) == len(joined.episode)
    assert len(np.unique(joined.sequence)) == sum(len(np.unique(part.sequence)) for part in parts)
    rows = len(parts[0].episode)
    np.testing.assert_array_equal(
        joined.rollout.felt.trace.wrench_sensor[rows:], parts[1].rollout.felt.trace.wrench_sensor
    )
    first, *others = compatibility.first_holes(joined)
    told = {"data": "f", "first_hole": first, "other_first_holes": others}
    assert len(others) == 1
    assert all(compatibility.shares_holes(told, part, "g") for part in parts)
    assert not compatibility.shares_holes(told, reader.load(collect(tmp_path / "third", seed=8)), "g")
    with pytest.raises(RequestError, match="a folder is given twice"):
        load_joined([folder, folder])


def test_longer_and_shorter_attempts_are_joined(folder, collect, tmp_path):
    short = reader.load(folder).rollout.felt.trace.action_world.shape[1]
    longer = collect(tmp_path / "longer", seed=6, actions=short + 2)
    joined = load_joined([folder, longer])
    trace = joined.rollout.felt.trace.action_world
    assert trace.shape[1] == short + 2
    assert not trace[: len(reader.load(folder).episode), short:].any()
