"""The same attempts with parts of sections in both engines: several physics steps per torque, chamfers."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from mjx_fit.config.files import read_config
from mjx_fit.config.part_sets import parts_file
from mjx_fit.data.schedule import draw_attempts
from mjx_fit.engines.select import make_engine

ATTEMPTS, ACTIONS = 16, 10
PARTS = ("round_8", "square_4", "d_sub")


@pytest.fixture(scope="module")
def both():
    """Rollouts of MJX and of C."""
    changes = ("detector.half_width_m=0.005", "detector.prior_std_m=0.003", "scene.contact_time_per_gap=20")
    config = read_config(parts_file("nist"), changes)
    shapes = tuple(shape for shape in config.scene.shapes if shape.name in PARTS)
    task = replace(config.task, success_probability=None, success_by_error=None)
    config = replace(config, scene=replace(config.scene, shapes=shapes), task=task)
    assert config.scene.physics_steps == 4
    asked = draw_attempts(jax.random.key(0), np.arange(ATTEMPTS), "spiral", config)
    return tuple(make_engine(name, config).run(asked, ACTIONS) for name in ("mjx", "native"))


def force(rollout) -> np.ndarray:
    """Force of all samples, N, and nothing after an attempt's end (n, samples)."""
    felt = rollout.felt
    pulled = np.asarray(felt.trace.wrench_sensor)[..., :3] - np.asarray(felt.tare_sensor)[:, None, None, :3]
    performed = np.arange(ACTIONS) < np.asarray(felt.length)[:, None]
    return np.where(performed[..., None], np.linalg.norm(pulled, axis=-1), np.nan).reshape(ATTEMPTS, -1)


@pytest.mark.slow
def test_pegs_press_and_slide_alike(both):
    ours, theirs = (force(one) for one in both)
    assert np.nanmedian(theirs) > 5
    median = np.nanmedian(ours, axis=1) / np.nanmedian(theirs, axis=1)
    assert np.median(median) == pytest.approx(1, abs=0.03)
    assert median.mean() == pytest.approx(1, abs=0.1)


def test_tips_follow_the_same_way(both):
    """Contact amplifies rounding, but few attempts part within a second."""
    ours, theirs = (np.asarray(one.felt.trace.tip_pos_world) for one in both)
    apart = np.linalg.norm(ours - theirs, axis=-1)[:, : ACTIONS // 2]
    assert np.median(apart) < 1e-4
    assert all(np.asarray(one.truth.valid).all() for one in both)
