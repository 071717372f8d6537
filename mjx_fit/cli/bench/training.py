"""Time one training step, here and in PyTorch: loss, gradient and Adam update on the same batch."""

import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from mjx_fit.cli.bench.peers import absence, load_peer
from mjx_fit.config.schema import Config
from mjx_fit.data.windows import Sample
from mjx_fit.sensors.contact_sensor import ContactSensor, InputScale
from mjx_fit.training.step import Recipe, TrainState, optimizer, train_step_jit
from mjx_fit.types import Belief, Reading
from mjx_fit.utils import children, numerics, process_setup
from mjx_fit.utils.rates import SUBSTEPS

TIMES = 10
"""Number of timed steps per process; the median over all processes counts."""
ROUNDS = 2
"""Number of processes of each kind, run alternately."""

Step = Callable[[], object]


def measure(config: Config) -> list[dict[str, Any]]:
    """Measure a row for each kind of step, or only for ours if PyTorch is absent."""
    names = ["train_step"] + ["train_step_torch"] * (absence("torch_twin") is None)
    seconds: dict[str, list[float]] = {name: [] for name in names}
    compile_s: dict[str, float] = {}
    for _ in range(ROUNDS):
        for name in names:
            with children.worker() as process:
                first, own = process.submit(_time, name, config).result()
            seconds[name] += own
            compile_s[name] = first
    median = {name: float(np.median(values)) for name, values in seconds.items()}
    return [
        {
            "name": name,
            "windows": config.train.batch_size,
            "steps_per_s": round(1 / median[name], 3),
            "compile_s": round(compile_s[name], 2),
            "seconds_over_torch": round(median[name] / median[names[-1]], 3) if len(names) > 1 else None,
        }
        for name in names
    ]


def sample_of(config: Config, seed: int = 0) -> Any:
    """Make a batch of random windows of all lengths; the values do not affect the duration of a step."""
    rng = np.random.default_rng(seed)
    n, rows = config.train.batch_size, config.train.max_window
    count = rng.integers(config.train.min_window, rows + 1, n)
    mask = np.arange(rows) < count[:, None]

    def noise(*shape):
        return jnp.asarray(rng.normal(size=(n, rows, *shape)), jnp.float32)

    peg, hole = (jnp.asarray(rng.integers(0, config.scene.n_types, n)) for _ in range(2))
    place = jnp.asarray(rng.uniform(-0.01, 0.01, (n, 2)), jnp.float32)
    reading = Reading(
        noise(SUBSTEPS, 6),
        noise(2),
        noise(3),
        noise(4),
        noise(3),
        noise(3),
        noise(),
        noise(3),
        jnp.asarray(mask),
        peg,
    )
    cov = jnp.broadcast_to(1e-4 * jnp.eye(2), (n, 2, 2))
    n_types = config.scene.n_types
    types = jnp.full((n, n_types), -np.log(n_types), jnp.float32)
    prior = Belief(jnp.zeros((n, 2)), cov, types)
    return Sample(reading, prior, hole, place, jnp.zeros(n, bool), jnp.ones(n, bool))


def _time(name: str, config: Config) -> tuple[float, list[float]]:
    process_setup.configure()
    step = (_ours if name == "train_step" else _pytorchs)(config)
    seconds = []
    for _ in range(TIMES + 1):
        began = time.perf_counter()
        step()
        seconds.append(time.perf_counter() - began)
    return seconds[0], seconds[1:]


def _ours(config: Config) -> Step:
    sample = sample_of(config)
    sensor = ContactSensor.of(config, nnx.Rngs(0))
    sensor.fit_input_scale(sample.reading)
    graph, params, scale = nnx.split(sensor, nnx.Param, InputScale)
    recipe = Recipe(graph, config, 1)
    state = [TrainState(params, scale, optimizer(config, 1).init(params))]
    weight, key = jnp.ones(config.train.batch_size), numerics.key(0)

    def step() -> None:
        state[0], _ = jax.block_until_ready(train_step_jit(recipe, state[0], sample, weight, key))

    return step


def _pytorchs(config: Config) -> Step:
    import torch  # pyright: ignore[reportMissingImports]

    torch_twin = load_peer("torch_twin")
    sample = sample_of(config)
    sensor = ContactSensor.of(config, nnx.Rngs(0))
    sensor.fit_input_scale(sample.reading)
    twin = torch_twin.ContactSensor(config.sensor, config.scene.n_types)
    torch_twin.copy_weights(sensor, twin)
    inputs, truth = torch_twin.inputs_of(sensor, sample)
    adam = torch.optim.Adam(
        twin.parameters(), lr=config.train.learning_rate, betas=(0.9, config.train.adam_b2)
    )

    def step() -> None:
        adam.zero_grad()
        torch_twin.filter_loss(twin(**inputs), truth).mean().backward()
        adam.step()

    return step
