"""A sensor that starts from one of fewer coordinates."""

import jax
import numpy as np
import pytest
from flax import nnx
from synthetic import make_rollouts

from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config
from mjx_fit.sensors.contact_sensor import ContactSensor, InputScale
from mjx_fit.sensors.reading import Window, read_window
from mjx_fit.training import start
from mjx_fit.training.start import Start
from mjx_fit.training.step import TrainState
from mjx_fit.types import Observation

SMALL = ["sensor.width=16", "sensor.heads=2", "sensor.layers=1", "sensor.conv_channels=[4, 4, 4, 4, 4]"]
NAMES = ("x", "y", "z", "yaw", "roll", "pitch")


def config_of(*names: str) -> Config:
    return read_config(None, [*SMALL, f"filter.coordinates=[{', '.join(names)}]"])


def with_large_heads(config: Config, seed: int) -> ContactSensor:
    sensor, rngs = ContactSensor.of(config, nnx.Rngs(seed)), nnx.Rngs(seed + 1)
    for head in (sensor.position, sensor.match, sensor.position_noise.head):
        if head is not None:
            head.last.kernel[...] = jax.random.normal(rngs.params(), head.last.kernel.shape)
    return sensor


def observed(sensor: ContactSensor) -> Observation:
    config, felt = config_of("x", "y"), make_rollouts(3, actions=12).felt
    return sensor(jax.vmap(lambda one: read_window(one, jax.random.key(0), config, Window(12)))(felt))


def grown(fewer: tuple[str, ...], more: tuple[str, ...]) -> tuple[ContactSensor, ContactSensor]:
    trained, new = with_large_heads(config_of(*fewer), 1), with_large_heads(config_of(*more), 5)
    graph, params, scale = nnx.split(new, nnx.Param, InputScale)
    begun = start.begin(Start(trained, {}), TrainState(params, scale, ()))
    return trained, nnx.merge(graph, begun.params, begun.scale)


@pytest.mark.parametrize(("fewer", "more"), [(2, 6), (3, 6), (2, 3), (6, 6)])
def test_it_says_of_the_first_coordinates_what_the_trained_one_says(fewer, more):
    before, after = map(observed, grown(NAMES[:fewer], NAMES[:more]))
    np.testing.assert_allclose(after.innovation[:, :fewer], before.innovation, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(
        after.pos_noise_cov[:, :fewer, :fewer], before.pos_noise_cov, rtol=1e-4, atol=1e-9
    )
    np.testing.assert_allclose(after.match_logits, before.match_logits, rtol=1e-5)
    assert after.innovation.shape == (3, more)
