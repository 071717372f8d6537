"""Checkpoints over time: one of an earlier commit, and one of a training that is killed for real."""

import dataclasses
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml
from places import EARLIER_RUN
from synthetic import PAPER_SENSOR, PAPER_TRAINING, make_episodes

from mjx_fit.cli import main
from mjx_fit.config.sections.measurement import WristConfig
from mjx_fit.sensors.reading import Window, read_window
from mjx_fit.training.checkpoint import load_sensor

EARLIER = EARLIER_RUN
"""Trained at commit 44816a7, before R of the trace, centre of pressure and places; with what that commit
observed in six noiseless readings."""

CLEAN = WristConfig().without_errors()
SMALL = {
    "sensor": {"width": 8, "layers": 1, "feedforward": 8, "conv_channels": [4] * 5} | PAPER_SENSOR,
    "train": PAPER_TRAINING
    | {
        "epochs": 40,
        "learning_rate": 1e-4,
        "batch_size": 4,
        "max_window": 6,
        "min_window": 3,
        "patience": 35,
        "baseline_share": 0.0,
    },
}


def test_a_checkpoint_of_an_earlier_commit_says_what_it_said():
    sensor, config = load_sensor(EARLIER)
    felt = make_episodes(6, actions=8).rollout.felt
    clean = dataclasses.replace(config, wrist=CLEAN)
    readings = jax.vmap(lambda one: read_window(one, jax.random.key(0), clean, Window(8)))(felt)
    bits = (EARLIER / "contact.json").read_text()  # a draw, before contact was told from force
    readings = dataclasses.replace(readings, contact=jnp.asarray(json.loads(bits), jnp.float32))
    for name, want in json.loads((EARLIER / "observation.json").read_text()).items():
        np.testing.assert_allclose(getattr(sensor(readings), name), want, rtol=1e-4, atol=2e-7)


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_training_killed_for_real_gives_the_same_curve(tmp_path):
    """SIGKILL at several epochs; the first of them before, later ones behind the first checkpoint."""
    data = tmp_path / "data"
    (tmp_path / "c.yaml").write_text(yaml.safe_dump(SMALL))
    assert main.main(["collect", "--out", str(data), "--episodes", "12", "--steps", "6"]) == 0
    whole = train_command(data, tmp_path / "whole", tmp_path / "c.yaml")
    assert subprocess.run(whole, check=False, capture_output=True).returncode == 0
    out = tmp_path / "out"
    command = train_command(data, out, tmp_path / "c.yaml")
    for epochs in (1, 12, 30):
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        wait_for_epochs(out, epochs, process)
        process.send_signal(signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL
    assert subprocess.run(command, check=False, capture_output=True).returncode == 0
    assert curve(out) == curve(tmp_path / "whole")
    one, other = (load_sensor(run)[0] for run in (out, tmp_path / "whole"))
    jax.tree.map(np.testing.assert_array_equal, *map(jax.tree.leaves, (one, other)))


def train_command(data: Path, out: Path, config: Path) -> list[str]:
    options = ["--data", str(data), "--out", str(out), "--config", str(config)]
    return [sys.executable, "-m", "mjx_fit", "train", *options]


def wait_for_epochs(out: Path, epochs: int, process: subprocess.Popen) -> None:
    began = time.monotonic()
    path = out / "metrics.jsonl"
    while not path.is_file() or path.read_text().count("\n") < epochs:
        assert process.poll() is None, "it ended before it could be killed"
        assert time.monotonic() - began < 200
        time.sleep(0.002)


def curve(out: Path) -> list[dict]:
    rows = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
    for row in rows:
        row.pop("seconds")
    return rows
