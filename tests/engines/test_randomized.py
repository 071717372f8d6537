"""Worlds with physics of their own: like worlds whose configuration has these values, in both engines."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mjx_fit.config.files import read_config
from mjx_fit.config.quantities import QUANTITIES
from mjx_fit.config.randomized import PART_SCALE
from mjx_fit.config.schema import Config, config_from_tree, config_to_tree
from mjx_fit.config.worlds import world_file
from mjx_fit.data.schedule import draw_attempts
from mjx_fit.engines.mjx.engine import MjxEngine
from mjx_fit.engines.mjx.step import Models as MjxModels
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.engines.native.models import Models
from mjx_fit.engines.select import make_engine
from mjx_fit.scene.build import simulation_scene
from mjx_fit.scene.pieces import padded, peg_pieces, socket_pieces
from mjx_fit.scene.variation import box_ids, slopes
from mjx_fit.types import Attempt
from mjx_fit.types.physics import Physics, drawn
from mjx_fit.utils.errors import RequestError

PAPER = read_config(world_file("paper")[0], ())
FORGE = read_config(world_file("forge")[0], ())
N = 6
VALUES = {
    "friction": 0.75,
    "contact_time_s": 0.015625,
    "contact_damping": 1.5,
    "clearance_m": 0.0015,
    "kp_position": 512.0,
    "kp_orientation": 768.0,
    "damping_ratio": 1.5,
    "smoothing_s": 0.0625,
    "goal_delay_s": 0.03125,
    "dead_zone_n": 2.0,
    "dead_zone_nm": 0.25,
    "joint_friction_nm": 0.25,
    "joint_damping_nms": 0.5,
    "payload_kg": 0.125,
    "tilt_x_rad": 0.00390625,
    "tilt_y_rad": -0.0078125,
}
"""Values far from the defaults; most are exact in single precision."""


def attempts(**physics: float) -> Attempt:
    asked = draw_attempts(jax.random.key(4), jnp.arange(N), "spiral", PAPER)
    own = {name: np.full(N, value, np.float32) for name, value in physics.items()}
    return dataclasses.replace(asked, physics=Physics(**own)) if own else asked


def configured(**values: float) -> Config:
    tree = config_to_tree(PAPER)
    for name, value in values.items():
        tree[QUANTITIES[name].section][name] = value
    return config_from_tree(tree)


def wrench(rollouts) -> np.ndarray:
    return rollouts.felt.trace.wrench_sensor


@pytest.mark.parametrize("name", list(VALUES))
def test_a_world_with_a_value_is_like_a_configuration_with_it(name):
    value = VALUES[name]
    own = NativeEngine(PAPER, 1).run(attempts(**{name: value}), 6, horizon=100)
    same = NativeEngine(configured(**{name: value}), 1).run(attempts(), 6, horizon=100)
    other = NativeEngine(PAPER, 1).run(attempts(), 6, horizon=100)
    differs = abs(wrench(own) - wrench(same))
    assert np.median(differs) <= 1e-4 * abs(wrench(same)).max()
    # Rounding of the controller grows where the peg slides over an edge.
    assert np.quantile(differs, 0.95) < 0.2 * np.quantile(abs(wrench(own) - wrench(other)), 0.95)
    np.testing.assert_allclose(own.felt.trace.tip_pos_world, same.felt.trace.tip_pos_world, atol=2e-4)
    assert abs(wrench(own) - wrench(other)).max() > 1e-3


@pytest.mark.parametrize("scale", PART_SCALE)
def test_geometry_is_that_of_compiled_models(scale):
    scene = simulation_scene(PAPER.scene)
    other = dataclasses.replace(PAPER.scene, clearance_m=0.0023)
    physics = Physics(clearance_m=np.full(9, 0.0023), part_scale=np.full(9, scale))
    for model, pair in zip(Models(scene).of(np.arange(9), physics), range(9), strict=True):
        peg, hole = divmod(pair, 3)
        for prefix, make, kind in (("peg_", peg_pieces, peg), ("hole_", socket_pieces, hole)):
            centre, half = map(
                np.array, zip(*(piece.box for piece in padded(make, other, scale)[kind]), strict=True)
            )
            ids = box_ids(scene, prefix, len(centre))
            np.testing.assert_allclose(model.geom_pos[ids], centre, atol=1e-12)
            np.testing.assert_allclose(model.geom_size[ids], half, atol=1e-12)
    assert set(slopes(scene)) == {"clearance_m", "part_scale"}
    mjx_models, _ = MjxModels.of(scene).of_worlds(jnp.arange(9), jax.tree.map(jnp.asarray, physics))
    for i, model in enumerate(Models(scene).of(np.arange(9), physics)):
        np.testing.assert_allclose(mjx_models.mjx.geom_size[i], model.geom_size, atol=1e-7)
        np.testing.assert_allclose(mjx_models.mjx.geom_pos[i], model.geom_pos, atol=1e-7)


def test_a_changed_clearance_is_simulated_like_a_compiled_one():
    close = attempts(clearance_m=0.003)
    close = dataclasses.replace(close, estimate_world=close.hole_pos_world, hole_type=close.peg_type)
    own = NativeEngine(PAPER, 1).run(close, 30, horizon=100)
    plain = dataclasses.replace(close, physics=Physics())
    same = NativeEngine(configured(clearance_m=0.003), 1).run(plain, 30, horizon=100)
    assert own.truth.inserted.all()
    np.testing.assert_array_equal(own.felt.length, same.felt.length)
    np.testing.assert_allclose(own.felt.trace.tip_pos_world, same.felt.trace.tip_pos_world, atol=5e-4)


def test_worlds_of_a_batch_do_not_mix():
    asked = draw_attempts(jax.random.key(2), jnp.arange(N), "spiral", FORGE)
    engine = NativeEngine(FORGE, 2)
    together = engine.run(asked, 4, horizon=100)
    for row in (0, N - 1):
        alone = engine.run(jax.tree.map(lambda leaf, row=row: leaf[row : row + 1], asked), 4, horizon=100)
        np.testing.assert_array_equal(wrench(together)[row], wrench(alone)[0])
    for name, values in drawn(together.truth.physics).items():
        np.testing.assert_array_equal(values, getattr(asked.physics, name))


def test_the_robot_does_not_see_the_tilt_of_its_tool():
    tilted = NativeEngine(PAPER, 1).run(attempts(tilt_x_rad=0.02), 1, horizon=100)
    quat = tilted.felt.trace.tip_quat_world[:, 0]
    assert 2 * np.arccos(np.clip(abs(quat[:, 1]), 0, 1)).max() < 0.008


@pytest.mark.slow
@pytest.mark.parametrize(
    "names",
    [
        ("friction", "contact_time_s", "clearance_m"),
        (
            "kp_position",
            "tilt_x_rad",
            "dead_zone_n",
            "payload_kg",
            "joint_friction_nm",
            "smoothing_s",
            "goal_delay_s",
        ),
    ],
)
def test_mjx_worlds_are_like_configured_ones(names):
    values = {name: VALUES[name] for name in names}
    own = MjxEngine(PAPER, 2).run(attempts(**values), 4, horizon=100)
    same = MjxEngine(configured(**values), 2).run(attempts(), 4, horizon=100)
    differs = abs(wrench(own) - wrench(same))
    assert np.median(differs) <= 1e-3 * abs(wrench(same)).max()
    np.testing.assert_allclose(own.felt.trace.tip_pos_world, same.felt.trace.tip_pos_world, atol=2e-4)


@pytest.mark.slow
def test_both_engines_store_the_same_draws_and_simulate_alike():
    asked = draw_attempts(jax.random.key(2), jnp.arange(24), "spiral", FORGE)
    one, other = (engine(FORGE, 2).run(asked, 8, horizon=100) for engine in (NativeEngine, MjxEngine))
    for name, values in drawn(one.truth.physics).items():
        np.testing.assert_array_equal(values, getattr(other.truth.physics, name))
    np.testing.assert_allclose(one.felt.tare_sensor, other.felt.tare_sensor, atol=1e-3)
    force = [np.abs(wrench(done)[..., 2]).mean((1, 2)) for done in (one, other)]
    assert np.corrcoef(*force)[0, 1] > 0.95


@pytest.mark.parametrize(
    ("physics", "words"),
    [
        (Physics(friction=np.full(N, 9, np.float32)), "physics.friction of row 0: 9 is invalid"),
        (Physics(friction=np.full(N, np.nan, np.float32)), "physics.friction of row 0: nan is invalid"),
        (Physics(part_scale=np.full(N, 0.5, np.float32)), "expected 0.8 to 1.2"),
        (Physics(friction=np.full(N + 1, 0.5, np.float32)), r"expected floats \(6,\)"),
        (Physics(friction=np.full(N, 1)), r"expected floats \(6,\)"),
        (Physics(friction=0.5), "float is invalid"),  # pyright: ignore[reportArgumentType]
        (3, "int is invalid: expected Physics"),
    ],
)
def test_bad_physics_are_refused(physics, words):
    with pytest.raises(RequestError, match=words):
        NativeEngine(PAPER, 1).run(dataclasses.replace(attempts(), physics=physics), 1)


PRONGS = (
    "scene.shapes=[{name: plug, rectangles: [[-0.011, -0.01, -0.001, 0.01], [0.001, -0.01, 0.011, 0.01]]}]"
)
"""Two prongs 2 mm apart: their holes merge at the default clearance of 1 mm."""


def with_prongs(*overrides: str) -> Config:
    return read_config(world_file("paper")[0], (PRONGS, *overrides))


def test_shapes_whose_holes_touch_are_simulated():
    config = with_prongs()
    asked = draw_attempts(jax.random.key(0), jnp.arange(2), "spiral", config)
    assert NativeEngine(config, 1).run(asked, 2).truth.valid.all()
    MjxModels.of(simulation_scene(config.scene)).of_worlds(jnp.arange(1))


@pytest.mark.parametrize("ends", ["[0.0005, 0.0009]", "[0.0009, 0.0015]"])
def test_a_range_over_which_a_gap_closes_is_refused(ends):
    config = with_prongs(f"randomize.clearance_m={{uniform: {ends}}}")
    with pytest.raises(RequestError, match=r"randomize\.clearance_m.* cannot be used: a gap of a shape"):
        make_engine("native", config)


def test_given_clearances_over_which_a_gap_closes_are_refused():
    config = with_prongs()
    asked = draw_attempts(jax.random.key(0), jnp.arange(2), "spiral", config)
    asked = dataclasses.replace(asked, physics=Physics(clearance_m=np.array([0.0012, 0.0008], np.float32)))
    with pytest.raises(RequestError, match=r"attempts: physics\.clearance_m: 0\.0008 cannot be used: a gap"):
        NativeEngine(config, 1).run(asked, 2)


def test_a_range_without_such_a_gap_is_simulated():
    config = with_prongs("scene.clearance_m=0.0005", "randomize.clearance_m={uniform: [0.0003, 0.0009]}")
    asked = draw_attempts(jax.random.key(0), jnp.arange(2), "spiral", config)
    assert make_engine("native", config).run(asked, 2).truth.valid.all()


def test_scaled_parts_need_room():
    with pytest.raises(RequestError, match=r"scene\.plate_half_width_m: 0\.08 is invalid"):
        read_config(None, ["randomize.part_scale={uniform: [1, 1.2]}", "spiral.radius_m=0.03"])
    read_config(None, ["randomize.part_scale={uniform: [0.8, 1]}", "spiral.radius_m=0.03"])
