"""The sensor and its loss against the same written in PyTorch, with the same weights."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from synthetic import PAPER_SENSOR, PAPER_TRAINING, make_episodes

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.learning import SensorConfig, TrainConfig
from mjx_fit.data.windows import sample_windows
from mjx_fit.sensors.contact_sensor import ContactSensor
from mjx_fit.training.loss import filter_loss

pytest.importorskip("torch")

CONFIG = Config(
    sensor=SensorConfig(
        width=16, conv_channels=(4, 4, 8, 8, 8), layers=2, heads=2, feedforward=16, **PAPER_SENSOR
    ),
    train=TrainConfig(min_window=3, max_window=9, **PAPER_TRAINING),
)


@pytest.fixture(scope="module")
def sample():
    data = make_episodes(12, actions=12, min_length=6)
    return sample_windows(data, jnp.arange(12), jax.random.key(1), CONFIG)


@pytest.fixture(scope="module")
def sensor(sample):
    sensor = ContactSensor(CONFIG.sensor, nnx.Rngs(0))
    sensor.fit_input_scale(sample.reading)
    return sensor


def test_loss_and_gradients_are_pytorchs(sensor, sample):
    from benchmarks import torch_twin

    twin = torch_twin.ContactSensor(CONFIG.sensor)
    torch_twin.copy_weights(sensor, twin)
    inputs, truth = torch_twin.inputs_of(sensor, sample)
    theirs = torch_twin.filter_loss(twin(**inputs), truth)

    def mean_loss(sensor):
        losses = filter_loss(sensor(sample.reading), sample)
        return losses.total.mean(), losses.total

    (_, ours), grads = nnx.value_and_grad(mean_loss, has_aux=True)(sensor)
    assert np.asarray(ours) == pytest.approx(np.asarray(theirs.detach()), abs=2e-4)
    theirs.mean().backward()
    for jax_layer, torch_layer in (
        (grads["trace_encoder"]["wrench_encoder"]["layers"][0], twin.wrench_encoder.layers[0]),
        (grads["trace_encoder"]["blocks"][1]["query_key_value"], twin.blocks[1].query_key_value),
        (grads["position"]["last"], twin.position.last),
        (grads["match"]["first"], twin.match.first),
    ):
        kernel = np.asarray(jax_layer["kernel"][...])
        weight = np.asarray(torch_layer.weight.grad)
        if weight.ndim == 3:  # a convolution
            weight = weight.transpose(0, 2, 1).reshape(len(weight), -1)
        assert pytest.approx(weight, abs=1e-3 * float(np.abs(weight).max())) == kernel.T
    noise = np.asarray(grads["position_noise"]["raw"]["embedding"][...])
    assert noise == pytest.approx(np.asarray(twin.position_noise.weight.grad), abs=1e-4)
