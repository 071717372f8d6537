"""The examples that read a data set without this library."""

import importlib.util
import re
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from collecting import Collector, run
from fakes import FakeEngine
from places import EXPERIMENTS

from mjx_fit.config.schema import Config
from mjx_fit.types import Attempt, Belief, Observation

EXAMPLES = EXPERIMENTS / "data"


@pytest.fixture(scope="module")
def folder(native, tmp_path_factory):
    return Collector(native)(tmp_path_factory.mktemp("data") / "set", sequence=2)


def test_plain_h5py(folder):
    done = run([sys.executable, str(EXAMPLES / "read_h5py.py"), str(folder)])
    assert done.returncode == 0, done.stderr
    assert "10 rollouts, policy mixed" in done.stdout
    assert "trace/wrench_sensor" in done.stdout
    assert "[N, N·m] sensor force and torque" in done.stdout
    assert "episode 0: cross in cross, 3 actions" in done.stdout


def test_plain_h5py_on_the_sample():
    done = run([sys.executable, str(EXAMPLES / "read_h5py.py"), str(EXAMPLES / "sample")])
    assert done.returncode == 0, done.stderr
    assert "24 rollouts, policy mixed" in done.stdout


def test_plain_h5py_needs_nothing_of_this_library():
    for name in ("read_h5py.py", "read_torch.py"):
        assert "mjx_fit" not in (EXAMPLES / name).read_text()


def test_torch(folder):
    pytest.importorskip("torch")
    done = run([sys.executable, str(EXAMPLES / "read_torch.py"), str(folder)])
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0] == "10 interactions"
    assert "wrench (10, 3, 50, 6), lengths 3 to 3" in done.stdout
    assert "6 matched" in done.stdout


def test_the_array_job_is_a_shell_script_that_parses():
    subprocess.run(["bash", "-n", str(EXAMPLES / "slurm.sh")], check=True)


OWN = EXAMPLES.parent / "own"


def own(name: str, *words: object) -> list[str]:
    done = run([sys.executable, str(OWN / name), *map(str, words)])
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_a_shape_of_ones_own(tmp_path):
    told = own("shape.py", tmp_path / "set", 12, 3)
    assert "ell-ell: 0 of 3 inserted" in told  # in three actions
    assert {line.split(":")[0] for line in told} == {"ell-ell", "ell-square", "square-ell", "square-square"}


def own_module(name: str):
    spec = importlib.util.spec_from_file_location(f"own_{name}", OWN / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_policy_of_ones_own():
    told = own("policy.py", 2)
    assert [line.split(":")[0] for line in told] == ["spiral", "raster"]
    assert all(re.search(r"of 2 inserted$", line) and "% to " in line for line in told)


def test_the_raster_sweeps_its_square():
    raster = own_module("policy").raster
    tip = jnp.array([0.4, 0.1, 0.05])
    start = SimpleNamespace(estimate_world=jnp.array([0.41, 0.09]))
    steps = (SimpleNamespace(start=start, step=step, horizon=100, tip_pos_world=tip) for step in range(100))
    moves = np.array([raster(seen) for seen in steps])
    goals = moves[:, :2] + tip[:2] - start.estimate_world
    assert (moves[:, 2] < 0).all()
    assert np.allclose(np.unique(goals[:, 1].round(6)), np.linspace(-0.015, 0.015, 5))
    steps = np.abs(np.diff(goals, axis=0))
    assert np.abs(goals[:, 0]).max() == pytest.approx(0.015, abs=1e-3)
    assert steps.sum(1).max() < 0.01  # no jump, at the end of a line either


def test_a_sensor_of_ones_own(native, tmp_path):
    folders = [Collector(native)(tmp_path / f"set{seed}", seed=seed) for seed in (1, 2)]
    for test in folders:
        told = own("sensor.py", folders[0], test)
        assert [line.split(":")[0] for line in told] == ["nothing", "linear sensor"]
        nothing, linear = (float(line.split()[-6]) for line in told)
        assert linear != nothing
        if test == folders[0]:  # what it was fitted on: it has as many features as there are rows
            assert linear < 0.8 * nothing


def test_a_filter_of_ones_own():
    told = own("filter.py", 2)
    assert [line.split(":")[0] for line in told] == ["Kalman", "particles"]
    assert all(1 <= float(line.split()[1]) <= 10 for line in told)


def test_the_particle_filter_is_the_kalman_filter_where_failure_teaches_nothing(monkeypatch):
    module = own_module("filter")
    config = Config()
    never = tuple(tuple(0.0 for _ in rates) for rates in config.task.success_by_error or ())
    config = replace(config, task=replace(config.task, success_by_error=never))
    n, innovation, noise = 64, jnp.array([0.006, -0.004]), jnp.array([[4e-5, 1e-5], [1e-5, 2e-5]])
    rows = lambda leaf: jnp.broadcast_to(leaf, (n, *leaf.shape))  # noqa: E731
    monkeypatch.setattr(module.mf, "readings", lambda felt, keys, config: None)
    seen = Observation(rows(innovation), rows(noise), jnp.zeros((n, 2)), jnp.zeros((n, 3, 2)))
    mean, cov = jnp.array([0.4, 0.1]), jnp.diag(jnp.array([3e-5, 6e-5]))
    prior = Belief(rows(mean), rows(cov), jnp.zeros((n, 3)))
    kinds, keys = jnp.zeros(n, int), jax.random.split(jax.random.key(0), n)
    done = FakeEngine().run(Attempt(kinds, kinds + 1, rows(mean), rows(mean), kinds, keys), 2)
    learned = module.particle_filter(config, lambda _: seen)(
        prior, done.felt, jax.random.split(jax.random.key(1), n)
    )
    gain = cov @ np.linalg.inv(cov + noise)
    assert np.allclose(learned.pos_mean_world.mean(0), mean + gain @ innovation, atol=1e-4)
    assert np.allclose(learned.pos_cov.mean(0), cov - gain @ cov, atol=2e-6)


def test_examples_stay_short():
    for path in OWN.glob("*.py"):
        assert len(path.read_text().splitlines()) < 60, path
