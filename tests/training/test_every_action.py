"""Training after every action: the sensor knows something early, and wrong requests are refused."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import pytest
from flax import nnx
from synthetic import PAPER_SENSOR, PAPER_TRAINING, make_episodes

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.learning import SensorConfig, TrainConfig
from mjx_fit.data.windows import sample_windows
from mjx_fit.training.checkpoint import load_sensor
from mjx_fit.training.loop import train
from mjx_fit.training.loss import filter_loss
from mjx_fit.training.run import Run
from mjx_fit.training.split import require_growing
from mjx_fit.utils.errors import RequestError

EPISODES, ACTIONS = 240, 12
CONFIG = Config(
    sensor=SensorConfig(
        width=16,
        conv_channels=(4, 4, 8, 8, 8),
        layers=1,
        heads=2,
        feedforward=16,
        causal=True,
        **PAPER_SENSOR,
    ),
    train=TrainConfig(
        epochs=30,
        batch_size=32,
        learning_rate=5e-3,
        min_window=ACTIONS,
        max_window=ACTIONS,
        validation_fraction=0.25,
        every_action=True,
        **PAPER_TRAINING,
    ),
)


@pytest.mark.slow
def test_a_sensor_that_learns_after_every_action_knows_something_after_three(tmp_path):
    data = make_episodes(EPISODES, actions=ACTIONS, min_length=6)
    train(data, CONFIG, Run(tmp_path / "run", 0, tensorboard=True))
    rows = [json.loads(line) for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    assert rows[-1]["val_nll"] < rows[-1]["prior_nll"] - 0.3
    sensor, config = load_sensor(tmp_path / "run")
    sample = sample_windows(data, jnp.arange(EPISODES), jax.random.key(3), config)
    early = replace(
        sample, reading=replace(sample.reading, mask=sample.reading.mask & (jnp.arange(ACTIONS) < 3))
    )
    losses = nnx.jit(lambda sensor, sample: filter_loss(sensor(sample.reading), sample))(sensor, early)
    assert float(losses.nll.mean()) < float(losses.prior_nll.mean()) - 0.2


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"sensor": {"causal": False}}, r"cannot be used with sensor\.causal false"),
        ({"train": {"sequence": 2}}, r"cannot be used with train\.sequence 2: expected 1"),
    ],
)
def test_what_cannot_be_trained_after_every_action_is_refused(changes, words):
    require_growing(CONFIG)
    wrong = replace(CONFIG, **{name: replace(getattr(CONFIG, name), **own) for name, own in changes.items()})
    with pytest.raises(RequestError, match=rf"^config: train\.every_action: True {words}"):
        require_growing(wrong)
    require_growing(replace(wrong, train=replace(wrong.train, every_action=False)))
