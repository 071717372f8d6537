"""The computations that the benchmark times match its rows."""

from dataclasses import replace

import jax
import mujoco
import numpy as np
import pytest
from synthetic import PAPER_SENSOR, PAPER_TRAINING

from benchmarks import python_loop
from mjx_fit.cli.bench import peers, run, training
from mjx_fit.cli.bench.engines import CONTENDERS, attempts_of
from mjx_fit.config.schema import Config
from mjx_fit.config.sections.learning import SensorConfig, TrainConfig

CONFIG = Config()


@pytest.mark.parametrize("name", ["raw_batch", "native", "python_loop"])
def test_a_contender_counts_the_steps_that_it_makes(name):
    worlds = 1 if CONTENDERS[name].one_world else 5
    simulate = CONTENDERS[name].prepare(CONFIG, attempts_of(CONFIG, 5), 2)
    assert simulate() == worlds * 2 * 50
    assert simulate() == worlds * 2 * 50


def test_the_peer_presses_its_peg_on_the_plate():
    model, data, goal = python_loop.one_world(CONFIG, attempts_of(CONFIG, 1))
    for _ in range(500):
        mujoco.mj_step1(model, data)
        data.ctrl[:] = python_loop.torque(model, data, goal, CONFIG.control)
        mujoco.mj_step2(model, data)
    reading = data.sensordata[2] + 0.1 * 9.81
    assert 10 < reading < 40
    assert np.abs(data.qvel).max() < 0.02


def test_an_absent_peer_is_skipped_in_one_line(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(peers, "_FOLDER", tmp_path)
    monkeypatch.setattr(run, "measure", lambda name, *_: {"name": name, "physics_steps_per_s": 1})
    monkeypatch.setattr(training, "measure", lambda _: [{"name": "train_step"}])
    run.bench(CONFIG, as_json=True)
    told = capsys.readouterr()
    skipped = [line for line in told.err.splitlines() if "skipped" in line]
    assert skipped == [
        "bench: python_loop: skipped, benchmarks/python_loop.py comes with a checkout only",
        "bench: train_step_torch: skipped, benchmarks/torch_twin.py comes with a checkout only",
    ]
    assert "python_loop" not in told.out


def test_actions_shrink_with_worlds():
    assert run._actions("native", 256) == CONTENDERS["native"].actions
    assert run._actions("mjx", 4096) == 1
    assert run._actions("python_loop", 4096) == CONTENDERS["python_loop"].actions


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_row_says_what_the_contract_says():
    row = run.measure("native", CONFIG, 8)
    names = "name worlds physics_steps_per_s actions_per_s compile_s cached_compile_s peak_memory_mb"
    assert list(row) == names.split()
    assert row["worlds"] == 8
    assert row["physics_steps_per_s"] > 1000
    assert row["cached_compile_s"] <= row["compile_s"] + 1
    assert jax.default_backend() != "cpu" or row["peak_memory_mb"] > 50


def test_a_training_step_is_timed_on_windows_of_all_lengths():
    small = replace(
        CONFIG,
        sensor=SensorConfig(
            width=8, conv_channels=(4, 4, 4, 4, 4), layers=1, heads=2, feedforward=8, **PAPER_SENSOR
        ),
        train=TrainConfig(batch_size=16, min_window=3, max_window=12, **PAPER_TRAINING),
    )
    reading = training.sample_of(small).reading
    counts = np.asarray(reading.mask).sum(1)
    assert reading.wrench_sensor.shape == (16, 12, 50, 6)
    assert counts.min() >= 3
    assert len(set(counts.tolist())) > 3
    step = training._ours(small)
    step()
    step()
