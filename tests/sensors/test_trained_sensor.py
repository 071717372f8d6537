"""What is new to a sensor in another configuration."""

from typing import Any

import pytest

from mjx_fit.config.files import read_config
from mjx_fit.config.worlds import world_file
from mjx_fit.sensors.trained_sensor import TrainedSensor
from mjx_fit.utils.errors import RequestError

NETWORK: Any = object()
SENSOR = TrainedSensor(NETWORK, read_config(world_file("forge")), "f")


@pytest.mark.parametrize(
    ("change", "new"),
    [
        ("scene.friction=0.3", []),
        ("scene.friction=0.2", ["scene.friction is 0.25 to 1.25 there and 0.2 here"]),
        ("scene.friction=1.3", ["scene.friction is 0.25 to 1.25 there and 1.3 here"]),
        ("randomize.friction={uniform: [0.3, 1.2]}", []),
        (
            "randomize.friction={uniform: [0.3, 1.5]}",
            ["scene.friction is 0.25 to 1.25 there and 0.3 to 1.5 here"],
        ),
        ("scene.contact_time_s=0.02", ["scene.contact_time_s is 0.01 there and 0.02 here"]),
        ("randomize.part_scale={choice: [0.9, 1]}", ["randomize.part_scale is 1 there and 0.9 to 1 here"]),
        ("wrist.bandwidth_hz=20", []),  # none, as by default, counts as the highest, 250
        ("wrist.bandwidth_hz=19", ["wrist.bandwidth_hz is 20 to 250 there and 19 here"]),
        ("wrist.contact_force_n=2", ["wrist.contact_force_n is 1.0 there and 2.0 here"]),
        ("task.attempt_actions=50", ["task.attempt_actions is 100 there and 50 here"]),
        ("task.outcome_model=covariance", []),  # of the estimator, not of the traces
        ("filter.gate=0", []),
        ("scene.max_contacts=8", []),  # of MJX alone
        ("train.epochs=3", []),
    ],
)
def test_only_what_the_sensor_never_saw_is_new(change, new):
    assert SENSOR.differences(read_config(None, [change])) == new


@pytest.mark.parametrize(("actions", "new"), [(50, 0), (100, 0), (101, 1)])
def test_a_sensor_of_attempts_in_progress_knows_shorter_ones(actions, new):
    causal = TrainedSensor(NETWORK, read_config(world_file("forge"), ["sensor.causal=true"]), "f")
    here = read_config(None, [f"task.attempt_actions={actions}", "sensor.causal=true"])
    assert len(causal.differences(here)) == new


def test_a_changed_network_is_named_whatever_else_differs():
    changed = read_config(None, ["scene.friction=0.6", "sensor.width=16"])
    with pytest.raises(RequestError, match=r"^config: sensor\.width is 64 there and 16 here"):
        SENSOR.adapt(changed)
    assert SENSOR.adapt(read_config(None, ["scene.friction=0.6"])).scene.friction == 0.6
