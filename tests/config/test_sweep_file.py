"""Files of sweeps: which cells they mean, and what is said about those that mean none."""

import pytest
import yaml

from mjx_fit.config.schema import Config
from mjx_fit.config.sweep_file import read_sweep
from mjx_fit.utils.errors import RequestError

GRID = {"experiment": "attempt", "keys": {"scene.friction": [0.2, 0.4], "task.attempt_actions": [5, 6, 7]}}


@pytest.fixture
def read(tmp_path):
    def read(plan, overrides=(), **sections):
        path = tmp_path / "sweep.yaml"
        path.write_text(yaml.safe_dump({**sections, "sweep": plan}))
        return read_sweep([path], overrides)

    return read


def test_a_grid_is_every_combination(read):
    found = read(GRID | {"seeds": 3}, scene={"clearance_m": 0.002})
    pairs = [(one.scene.friction, one.task.attempt_actions) for one in found.configs]
    assert pairs == [(f, n) for f in (0.2, 0.4) for n in (5, 6, 7)]
    assert {one.scene.clearance_m for one in found.configs} == {0.002}
    assert found.plan.root_seeds == (0, 1, 2)
    assert found.base.scene.friction == Config().scene.friction


def test_a_list_changes_what_it_names(read):
    plan = {
        "experiment": "position",
        "methods": ["full"],
        "seeds": [7],
    }
    found = read(plan | {"keys": [{}, {"scene.friction": 0.5}]}, ["scene.friction=0.1"])
    assert [one.scene.friction for one in found.configs] == [0.1, 0.5]
    assert found.plan.settings == ({}, {"scene.friction": 0.5})
    assert found.plan.root_seeds == (7,)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"experiment": "robustness"}, "experiment: 'robustness' is invalid"),
        ({"keys": {"friction": [1]}}, "friction"),
        ({"keys": {"scene.friction": []}}, "scene.friction"),
        ({"keys": {"scene.frictoin": [1]}}, "scene.frictoin=1 cannot be used: config: scene.frictoin"),
        (
            {"keys": {"scene.friction": ["high"]}},
            "scene.friction='high' cannot be used: config: scene",
        ),
        ({"methods": ["full"]}, "methods: full is invalid: expected none for attempt"),
        ({"experiment": "insertion"}, "methods: nothing is invalid: expected names of methods"),
        ({"seeds": [1, 1]}, "sweep.seeds: a seed is given twice"),
        ({"seeds": 0}, "seeds"),
        ({"seeds": 9999}, "59994 cells are out of range: expected at most 10000"),
        ({"trails": 5}, "trails"),
        ({"keys": {f"scene.k{n}": [1] * 1000 for n in range(9)}}, "cells are out of range"),
    ],
)
def test_what_means_no_sweep_is_said(change, expected, read):
    with pytest.raises(RequestError) as refused:
        read(GRID | change)
    assert expected in str(refused.value)
    assert str(refused.value).startswith("config: sweep")
    assert "\n" not in str(refused.value)


def test_a_key_that_worlds_draw_is_refused(read):
    """Varying it would change nothing."""
    with pytest.raises(RequestError, match=r"scene\.friction has no effect: randomize\.friction draws it"):
        read(GRID, randomize={"friction": {"uniform": [0.2, 0.5]}})


def test_a_configuration_without_a_sweep_is_none(tmp_path):
    for text, message in (("scene: {clearance_m: 0.002}", "it is missing"), ("sweep: 3", "3 is invalid")):
        (tmp_path / "c.yaml").write_text(f"{text}\n")
        with pytest.raises(RequestError, match=rf"config: sweep: {message}: expected a section"):
            read_sweep([tmp_path / "c.yaml"])
