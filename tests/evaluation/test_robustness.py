"""Perturbations, and the experiment with a sensor that says what it was given."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic import make_rollouts

from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config, config_differences
from mjx_fit.config.worlds import world_file
from mjx_fit.evaluation import robustness
from mjx_fit.evaluation.perturbations import PERTURBATIONS, chosen_perturbations
from mjx_fit.evaluation.request import Request
from mjx_fit.evaluation.robustness import summarise
from mjx_fit.evaluation.statistics import Row
from mjx_fit.report.figures.robustness import Series, by_perturbation, compared
from mjx_fit.sensors.pose import from_down
from mjx_fit.types import Felt, Rollout
from mjx_fit.utils.errors import RequestError

NAMES = ("cross", "square")


def felt(n: int = 3, actions: int = 12) -> Felt:
    made = make_rollouts(n, actions=actions).felt
    quat = from_down(0.02 * jax.random.normal(jax.random.key(0), made.trace.tip_pos_world.shape))
    return replace(made, trace=replace(made.trace, tip_quat_world=np.asarray(quat)))


def changed(name: str, given: Felt) -> Felt:
    change = PERTURBATIONS[name].felt
    assert change is not None
    return change(given, Config())


def test_the_reference_changes_nothing_and_comes_first():
    assert next(iter(PERTURBATIONS)) == "home"
    home = PERTURBATIONS["home"]
    assert home.applied_to(Config()) == Config()
    assert home.felt is None


@pytest.mark.parametrize("name", list(PERTURBATIONS))
def test_each_other_changes_one_thing(name):
    perturbation = PERTURBATIONS[name]
    differs = config_differences(Config(), perturbation.applied_to(Config()))
    kinds = [bool(differs), perturbation.felt is not None, perturbation.other_engine]
    assert sum(kinds) == (name != "home")


def test_those_of_the_world_have_their_values():
    friction = PERTURBATIONS["friction_0.6"].applied_to(Config())
    assert friction.scene.friction == 0.6
    weaker, home = PERTURBATIONS["gains_-40%"].applied_to(Config()).control, Config().control
    assert weaker.kp_position == pytest.approx(0.6 * home.kp_position)
    assert weaker.kp_orientation == pytest.approx(0.6 * home.kp_orientation)
    assert PERTURBATIONS["contact_time_x2"].applied_to(Config()).scene.contact_time_s == 0.02


@pytest.mark.parametrize(("name", "axis"), [("tilt_x_0.1deg", 0), ("tilt_y_0.1deg", 1), ("yaw_0.1deg", 2)])
def test_all_orientations_turn_about_an_axis_of_the_world(name, axis):
    given = felt()
    one, other = (
        Rotation.from_quat(np.asarray(of.trace.tip_quat_world).reshape(-1, 4), scalar_first=True)
        for of in (given, changed(name, given))
    )
    expected = np.zeros(3)
    expected[axis] = np.deg2rad(0.1)
    np.testing.assert_allclose((other * one.inv()).as_rotvec(), np.tile(expected, (len(one), 1)), atol=1e-6)


def test_forces_are_biased_and_scaled_after_taring():
    given = felt()
    tare = np.asarray(given.tare_sensor)[:, None, None]
    before = np.asarray(given.trace.wrench_sensor) - tare
    biased = np.asarray(changed("force_bias_1n", given).trace.wrench_sensor) - tare
    np.testing.assert_allclose(biased - before, np.broadcast_to([1, 0, 0, 0, 0, 0], before.shape), atol=1e-5)
    scaled = np.asarray(changed("force_gain_+10%", given).trace.wrench_sensor) - tare
    np.testing.assert_allclose(scaled[..., :3], 1.1 * before[..., :3], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(scaled[..., 3:], before[..., 3:], atol=1e-5)


def test_a_slow_wrench_is_numpys_interpolation():
    given = felt()
    tare = np.asarray(given.tare_sensor)[:, None]
    x = np.asarray(given.trace.wrench_sensor).reshape(3, -1, 6) - tare
    found = np.asarray(changed("wrench_125hz", given).trace.wrench_sensor).reshape(3, -1, 6) - tare
    time = np.arange(x.shape[1])
    for attempt in range(3):
        for axis in range(6):
            expected = np.interp(time, time[::4], x[attempt, ::4, axis])
            np.testing.assert_allclose(found[attempt, :, axis], expected, atol=1e-4)


def test_names_are_checked():
    assert list(chosen_perturbations("home, delay_20ms")) == ["home", "delay_20ms"]
    for wrong in ("moon", "home,home", ""):
        with pytest.raises(
            RequestError, match=r"^--perturbations: .* is invalid: expected different ones of"
        ):
            chosen_perturbations(wrong)


def trial(number: int, matched: bool, errors_cm: list[float], squared: list[float], chance: float) -> dict:
    return {
        "trial": number,
        "method": "full",
        "perturbation": "home",
        "pair": ["cross", "cross" if matched else "square"],
        "error_cm": errors_cm,
        "squared_mahalanobis": squared,
        "match_probability": [0.5, *[chance] * 5],
        "inserted_at": None,
    }


def test_the_summary_by_hand():
    calm = [trial(i, False, [2.0] + [0.1] * 5, [1.0] * 6, 0.1 + 0.01 * i) for i in range(10)]
    lost = [trial(10 + i, False, [2.0] + [1.5] * 5, [60.0] * 6, 0.3) for i in range(10)]
    calm[0]["error_cm"][1], calm[0]["squared_mahalanobis"][1] = 1.1, 60.0  # once is not lost
    calm[0]["squared_mahalanobis"][0] = 60.0  # before the first attempt does not count
    matched = [trial(20 + i, True, [2.0] + [0.2] * 5, [1.0] * 6, 0.9) for i in range(10)]
    rows = {(row.metric, row.group): row for row in summarise([*calm, *lost, *matched])}
    assert rows["position_error_mm", "home:1"].value == pytest.approx(8.5)
    assert rows["position_error_mm", "home:1"].n == 20
    assert rows["coverage_90", "home:5"].value == 0.5
    assert rows["nees", "home:2"].value == pytest.approx(15.25)
    assert rows["runaway", "home"].value == 0.5
    assert rows["match_auroc", "home:1"].value == 1.0
    assert by_perturbation(list(rows.values())).axes[0].get_yticklabels()[0].get_text() == "home"


def test_sensors_are_compared_over_all_perturbations_that_any_has():
    def rows(names, value):
        return {name: Row("full", "any", f"{name}:1", value, value - 0.1, value + 0.1, 9) for name in names}

    both, one = rows(("home", "tilt"), 0.5), rows(("home", "noise"), 0.7)
    figure = compared([Series("a", "C0", "o", both, both), Series("b", "C1", "s", both, one)])
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == ["home", "tilt", "noise"]
    markers = [line for line in figure.axes[1].get_lines() if line.get_marker() == "s"]
    assert [float(np.ravel(line.get_xdata())[0]) for line in markers] == [0.7, 0.7]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["a", "b"]


class PretendSensor:
    network, fingerprint = None, "0" * 12

    def adapt(self, config):
        return config

    def differences(self, config):
        return []


class FailingEngine:
    """An engine whose attempts all fail."""

    name, policy_name, turns = "native", None, False

    def run(self, attempts, actions=None, active=None, horizon=None):
        n = len(attempts.peg_type)
        self.physics = attempts.physics
        made = make_rollouts(n, actions=12)
        down = np.tile(np.array([0.0, 1.0, 0.0, 0.0], np.float32), (n, 12, 1))
        trace = replace(made.felt.trace, tip_quat_world=down)
        felt = replace(made.felt, trace=trace, peg_type=np.asarray(attempts.peg_type))
        fails = {"inserted": np.zeros(n, bool), "valid": np.ones(n, bool)}
        return Rollout(felt, replace(made.truth, hole_type=np.asarray(attempts.hole_type), **fails))


@pytest.fixture
def heights(monkeypatch) -> list[np.ndarray]:
    """Heights that the sensor was given in each update, in an experiment without simulation."""
    given: list[np.ndarray] = []

    def learn(config, network):
        def update(beliefs, felt, keys):
            given.append(np.asarray(felt.trace.tip_pos_world[..., 2]))
            return beliefs

        return update

    monkeypatch.setattr(robustness, "filter_update", learn)
    monkeypatch.setattr(robustness, "make_engine", lambda name, config: FailingEngine())
    return given


def test_attempts_in_a_random_world_have_the_perturbed_value(heights, monkeypatch, tmp_path):
    """The other quantities, and the detections, are those of the reference; the place that counts moves."""
    engine = FailingEngine()
    monkeypatch.setattr(robustness, "make_engine", lambda name, config: engine)
    bench, drawn = read_config(world_file("bench")[0], ()), {}
    for name in ("home", "friction_0.6", "grasp_shift_3mm"):
        result = robustness.robustness(asked(tmp_path / f"{name}.json", bench), name)
        drawn[name] = engine.physics, [trial["error_cm"][0] for trial in result.trials]
    (home, before), (rough, same), (shifted, after) = drawn.values()
    assert home.friction is not None
    assert rough.friction is None
    assert shifted.grasp_x_m is None
    for one in (rough, shifted):
        np.testing.assert_array_equal(one.kp_position, home.kp_position)
        np.testing.assert_array_equal(one.socket_yaw_rad, home.socket_yaw_rad)
    assert same == before
    assert max(after) <= max(before) + 0.6
    assert after != before


def asked(out: Path, config: Config | None = None) -> Request:
    sensor: Any = PretendSensor()
    return Request(config or Config(), out, FailingEngine(), 4, sensor=sensor)


def test_a_perturbed_attempt_reaches_the_sensor(heights, tmp_path):
    """The update sees the changed measurements, at the same holes as without a perturbation."""
    request = asked(tmp_path / "r.json")
    result = robustness.robustness(request, "home,height_+0.5mm")
    assert len(result.trials) == 2 * 6
    np.testing.assert_allclose(heights[5] - heights[0], 0.0005, atol=1e-6)
    home, raised = (
        [t for t in result.trials if t["perturbation"] == name] for name in ("home", "height_+0.5mm")
    )
    assert [t["error_cm"][0] for t in home] == [t["error_cm"][0] for t in raised]
    assert robustness.robustness(request, "home,height_+0.5mm") == result


def test_it_resumes_at_the_perturbation_that_was_interrupted(heights, monkeypatch, tmp_path):
    names = "home,height_+0.5mm,height_-0.5mm"
    whole = robustness.robustness(asked(tmp_path / "whole.json"), names)
    made = len(heights)
    trials = robustness._trials

    def interrupted(*given):
        if given[-2].name == "height_-0.5mm":
            raise KeyboardInterrupt
        return trials(*given)

    with monkeypatch.context() as patched:
        patched.setattr(robustness, "_trials", interrupted)
        with pytest.raises(KeyboardInterrupt):
            robustness.robustness(asked(tmp_path / "r.json"), names)
    assert not (tmp_path / "r.json").exists()
    before = len(heights)
    with pytest.raises(RequestError, match="unfinished work of another request"):
        robustness.robustness(asked(tmp_path / "r.json"), "home,height_-0.5mm")
    resumed = robustness.robustness(asked(tmp_path / "r.json"), names)
    assert (resumed.trials, resumed.summary) == (whole.trials, whole.summary)
    assert len(heights) - before == made // 3
    assert not (tmp_path / "r.parts").exists()


def test_the_geometry_reads_in_place_of_a_sensor(heights, monkeypatch, tmp_path):
    """Also where a sensor is at hand; without either there is nothing to measure."""
    asked_for, learn = [], robustness.filter_update

    def seen(config, network):
        asked_for.append(network)
        return learn(config, network)

    monkeypatch.setattr(robustness, "filter_update", seen)
    bench = read_config(world_file("bench")[0], ())
    for sensor in (None, PretendSensor()):
        request = replace(asked(tmp_path / f"{sensor is None}.json", bench), sensor=sensor)
        result = robustness.robustness(request, "home")
        assert result.request["sensor"] == {}
    assert set(asked_for) == {None}
    with pytest.raises(RequestError, match=r"^--run is required"):
        robustness.robustness(replace(asked(tmp_path / "none.json"), sensor=None), "home")


@pytest.mark.parametrize("name", list(PERTURBATIONS))
def test_what_is_perturbed_is_not_drawn(name):
    """In a randomised world the perturbed quantity has the perturbation's value everywhere."""
    forge = read_config(world_file("forge")[0], ())
    perturbation = PERTURBATIONS[name]
    changed_ = perturbation.applied_to(forge)
    for name_ in (*perturbation.values, *perturbation.factors):
        section, key = name_.split(".")
        assert getattr(changed_.randomize, key, None) is None
        assert getattr(getattr(changed_, section), key) != getattr(getattr(forge, section), key)
