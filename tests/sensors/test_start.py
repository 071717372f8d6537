"""Readings relative to the start of an attempt: what no robot can calibrate has no effect."""

from dataclasses import replace
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from synthetic import make_rollouts

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.measurement import PoseConfig
from mjx_fit.sensors.features import row_features
from mjx_fit.sensors.pose import from_down, from_start, rotation_from_down, start_of, turned
from mjx_fit.task.estimator import readings
from mjx_fit.types import Felt, Reading, StartPose
from mjx_fit.utils.errors import RequestError

START = Config(pose=PoseConfig().without_errors())
WORLD = replace(START, sensor=replace(START.sensor, pose="world"))
N, ACTIONS = 3, 10
vectors = st.lists(st.floats(-0.2, 0.2), min_size=3, max_size=3).map(lambda v: np.array(v, np.float32))


class Here(Felt):
    """Measurements whose start is known."""

    start: StartPose  # pyright: ignore[reportIncompatibleVariableOverride]


def felt() -> Here:
    made = make_rollouts(N, actions=ACTIONS).felt
    quat = from_down(0.02 * jax.random.normal(jax.random.key(0), made.trace.tip_pos_world.shape))
    made = replace(made, trace=replace(made.trace, tip_quat_world=quat))
    return cast(Here, replace(made, start=start_of(made, WORLD)))


def read(attempts: Felt, config: Config = START) -> Reading:
    return readings(attempts, jax.random.split(jax.random.key(1), N), config)


def same(one: Reading, other: Reading, atol: float = 1e-6) -> None:
    for name, value in vars(one).items():
        if name != "tip_quat_world":
            np.testing.assert_allclose(value, getattr(other, name), atol=atol, err_msg=name)
    rows = [np.asarray(row_features(reading, as_vector=True)) for reading in (one, other)]
    real = np.asarray(one.mask)
    np.testing.assert_allclose(rows[0][real], rows[1][real], atol=atol)


def test_negated_quaternions_change_nothing():
    given_ = felt()
    negated = replace(given_, trace=replace(given_.trace, tip_quat_world=-given_.trace.tip_quat_world))
    same(read(given_), read(negated))


@given(vectors)
def test_an_offset_of_the_whole_scene_changes_nothing(offset):
    here = felt()
    there = replace(
        here,
        trace=replace(here.trace, tip_pos_world=here.trace.tip_pos_world + offset),
        start=replace(here.start, pos_world=here.start.pos_world + offset),
        estimate_world=here.estimate_world + offset[:2],
    )
    same(read(here), read(there))


@given(vectors)
def test_a_constant_rotation_of_the_tool_changes_nothing(rotation):
    here = felt()
    # The tool is mounted at an angle: all measured orientations are turned in the tool's frame.
    tool = Rotation.from_rotvec(rotation)

    def mounted(quat):
        made = Rotation.from_quat(np.asarray(quat).reshape(-1, 4), scalar_first=True) * tool
        return made.as_quat(scalar_first=True).reshape(np.shape(quat)).astype(np.float32)

    there = replace(
        here,
        trace=replace(here.trace, tip_quat_world=mounted(here.trace.tip_quat_world)),
        start=replace(here.start, quat_world=mounted(here.start.quat_world)),
    )
    same(read(here), read(there), atol=2e-5)


def test_the_rotation_is_scipys():
    here = felt()
    start = replace(here.start, quat_world=turned(here.start.quat_world, jnp.array([0.1, -0.05, 0.02])))
    relative = jax.vmap(from_start)(here.trace, start)
    for i in range(N):
        before = Rotation.from_quat(np.asarray(start.quat_world[i]), scalar_first=True)
        during = Rotation.from_quat(np.asarray(here.trace.tip_quat_world[i]), scalar_first=True)
        expected = (during * before.inv()).as_rotvec()
        np.testing.assert_allclose(rotation_from_down(relative.tip_quat_world[i]), expected, atol=1e-5)


def test_without_a_measured_start_it_is_that_of_simulated_attempts():
    measured = felt()
    same(read(measured), read(replace(measured, start=None)))


def test_heights_are_relative_to_the_start_and_places_to_the_estimate():
    here = felt()
    absolute, relative = read(here, WORLD), read(here)
    mask = np.asarray(relative.mask)
    differs = np.asarray(absolute.tip_pos_estimate - relative.tip_pos_estimate)[mask]
    np.testing.assert_allclose(differs, np.tile([0, 0, 0.002], (mask.sum(), 1)), atol=1e-7)


def test_a_start_that_is_none_is_refused():
    here = felt()
    crooked = replace(here.start, quat_world=2 * here.start.quat_world)
    with pytest.raises(RequestError, match=r"start\.quat_world"):
        read(replace(here, start=crooked))
    with pytest.raises(RequestError, match=r"start\.pos_world: the value .* is invalid"):
        read(replace(here, start=replace(here.start, pos_world=np.nan * here.start.pos_world)))
    with pytest.raises(RequestError, match=r"start\.pos_world: shape"):
        read(replace(here, start=replace(here.start, pos_world=here.start.pos_world[:, :2])))


def test_a_calibration_error_of_the_orientation_is_drawn_and_has_no_effect_from_the_start():
    here = felt()
    wrong = replace(WORLD.pose, rotation_offset_rad=0.02)
    absolute, off = read(here, WORLD), read(here, replace(WORLD, pose=wrong))
    real = np.asarray(off.mask)
    turned_by = rotation_from_down(off.tip_quat_world) - rotation_from_down(absolute.tip_quat_world)
    assert 0.005 < np.std(np.asarray(turned_by)[real]) < 0.06
    same(read(here), read(here, replace(START, pose=wrong)), atol=3e-3)
