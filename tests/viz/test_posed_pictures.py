"""Pictures on the bench: sockets, the peg in hand, the tool and the marks of a belief stand as they are."""

from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mjx_fit.cli import picture_commands
from mjx_fit.cli.parser import parser
from mjx_fit.config.files import read_config
from mjx_fit.config.schema import config_to_tree
from mjx_fit.config.worlds import preset, world_file
from mjx_fit.engines.native.models import Models
from mjx_fit.engines.select import make_engine
from mjx_fit.evaluation import playback, results
from mjx_fit.evaluation.playback import Pick
from mjx_fit.scene.build import pair_index, simulation_scene
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.scene.placement import setting_of
from mjx_fit.task.seek import GEOMETRIC
from mjx_fit.types import Belief
from mjx_fit.viz.belief_marks import RADIUS_90, STDS_90, marks_of
from mjx_fit.viz.panel import Panel
from mjx_fit.viz.scene_model import Puppet
from mjx_fit.viz.timeline import moments

BENCH = read_config(world_file("bench"))
CONFIG = replace(BENCH, task=replace(BENCH.task, n_holes=3, max_attempts=2, attempt_actions=6))
DOWN = Rotation.from_quat([0.0, 1.0, 0.0, 0.0], scalar_first=True)


@pytest.fixture(scope="module")
def played():
    *_, recording = playback.record(CONFIG, Pick("failure_only", 1), 5, make_engine("native", CONFIG))
    return recording


@pytest.fixture(scope="module")
def posed(played):
    puppet, shown = Puppet(played), moments(played, fps=2, speed=1.0)
    postures = puppet.postures(np.stack([moment.tip_world for moment in shown]))
    return puppet, list(zip(shown, postures, strict=True))


def test_sockets_stand_as_they_were_drawn(played, posed):
    puppet, rows = posed
    puppet.pose(rows[0][0], played.steps[0], rows[0][1])
    physics = played.physics
    for hole in range(3):
        body = puppet.data.body(f"hole{hole}")
        names = ("socket_roll_rad", "socket_pitch_rad", "socket_yaw_rad")
        angles = [float(getattr(physics, name)[hole]) for name in names]
        assert np.abs(angles).max() > 0.01
        want = Rotation.from_euler("xyz", angles)
        assert (Rotation.from_matrix(body.xmat.reshape(3, 3)) * want.inv()).magnitude() < 1e-5
        np.testing.assert_allclose(body.xpos[:2], played.hole_pos_world[hole], atol=1e-6)
        want_z = plate_top_m(CONFIG.scene) + float(np.asarray(physics.socket_z_m)[hole])
        assert body.xpos[2] == pytest.approx(want_z, abs=1e-6)


def test_the_peg_is_held_as_the_engine_holds_it(played, posed):
    """Its geoms stand in the hand's frame as those of the simulated model, which has spare ones behind."""
    puppet, rows = posed
    scene = simulation_scene(CONFIG.scene)
    setting = setting_of(jnp.asarray(played.hole_pos_world), played.physics, CONFIG)
    kinds = np.asarray(played.peg_type)
    pair = np.asarray(pair_index(kinds, kinds, scene.n_types))
    simulated = Models(scene).of(pair, played.physics, setting.peg_hand)
    pegs = set()
    for moment, qpos in rows:
        step = played.steps[moment.step]
        if not moment.holding or step.peg in pegs:
            continue
        pegs.add(step.peg)
        puppet.pose(moment, step, qpos)
        model = simulated[step.peg]
        first = model.body_geomadr[model.body("peg").id]
        drawn = puppet._hand[kinds[step.peg]]
        hand = puppet.data.body("peg")
        for geom, twin in zip(drawn, range(first, first + len(drawn)), strict=True):
            away = puppet.data.geom_xpos[geom] - hand.xpos
            np.testing.assert_allclose(hand.xmat.reshape(3, 3).T @ away, model.geom_pos[twin], atol=1e-6)
            turned = hand.xmat.reshape(3, 3).T @ puppet.data.geom_xmat[geom].reshape(3, 3)
            want = np.empty(9)
            mujoco.mju_quat2Mat(want, model.geom_quat[twin])
            np.testing.assert_allclose(turned, want.reshape(3, 3), atol=1e-6)
    assert len(pegs) > 1


def test_the_tool_turns_as_recorded_and_starts_as_believed(played, posed):
    puppet, rows = posed
    for moment, qpos in rows:
        step = played.steps[moment.step]
        puppet.pose(moment, step, qpos)
        tip = puppet.data.site("tip")
        np.testing.assert_allclose(tip.xpos, moment.tip_pos_world, atol=1e-4)
        want = Rotation.from_rotvec(moment.tip_turn_world) * DOWN
        assert (Rotation.from_matrix(tip.xmat.reshape(3, 3)) * want.inv()).magnitude() < 1e-3
        estimate = np.asarray(step.rollout.felt.estimate_world)
        if moment.phase == "attempt" and moment.actions == 0:
            np.testing.assert_allclose(moment.tip_turn_world, estimate[[4, 5, 3]], atol=1e-5)
        if moment.phase == "attempt" and moment.actions == int(moment.actions) > 0:
            quat = np.asarray(step.rollout.felt.trace.tip_quat_world)[int(moment.actions) - 1]
            seen = Rotation.from_quat(quat, scalar_first=True) * DOWN.inv()
            np.testing.assert_allclose(moment.tip_turn_world, seen.as_rotvec(), atol=1e-5)


def test_marks_lie_as_the_socket_is_believed_to_stand():
    yaw, roll, pitch = 0.3, 0.1, -0.05
    mean = np.array([[0.5, 0.1, 0.002, yaw, roll, pitch]], np.float32)
    std = np.array([0.004, 0.002, 0.001, 0.05, 0.02, 0.02])
    belief = Belief(mean, np.diag(std**2)[None].astype(np.float32), np.log(np.full((1, 3), 1 / 3)))
    disc, dot, needle, *ends = marks_of(belief, np.array([True]), CONFIG)
    stands = Rotation.from_rotvec([roll, pitch, yaw])
    np.testing.assert_allclose(disc.frame_world[:, 2], stands.as_matrix()[:, 2], atol=1e-6)
    np.testing.assert_allclose(disc.size[:2], RADIUS_90 * std[:2], rtol=1e-4)
    np.testing.assert_allclose(dot.centre_world[:2], mean[0, :2], atol=1e-3)
    along = stands.as_matrix()[:, 0]
    np.testing.assert_allclose(needle.frame_world[:, 0], along, atol=1e-6)
    assert (needle.centre_world - disc.centre_world) @ along > 0.005
    for end, sign in zip(ends, (-1, 1), strict=True):
        off = stands.inv() * Rotation.from_matrix(end.frame_world)
        np.testing.assert_allclose(off.as_rotvec(), [0, 0, sign * STDS_90 * std[3]], atol=1e-5)
    assert marks_of(belief, np.array([False]), CONFIG) == []


def test_a_belief_about_x_and_y_has_neither_needle_nor_words(played):
    planar = replace(CONFIG, filter=replace(CONFIG.filter, coordinates=("x", "y")))
    belief = Belief(np.array([[0.5, 0.1]]), 1e-4 * np.eye(2)[None], np.log(np.full((1, 3), 1 / 3)))
    assert len(marks_of(belief, np.array([True]), planar)) == 2
    moment = moments(played, fps=2, speed=1.0)[0]
    words = dict(Panel(played, 460, 720).words(moment))
    assert words["hole 1"].endswith("yaw 0 ± 6°")
    flat = replace(played, config=planar, steps=played.steps)
    assert "yaw" not in str(Panel(flat, 460, 720).words(moment))
    assert jax.tree.leaves(moment.belief)[0].shape == (3, 6)


def test_a_result_of_the_geometry_is_replayed_with_its_policy(tmp_path, monkeypatch):
    stored = SimpleNamespace(
        config=config_to_tree(preset("gentle", "bench")),
        request={"policy": GEOMETRIC},
        engine="native",
        experiment="assembly",
    )
    monkeypatch.setattr(results, "read", lambda path: stored)
    asked = []
    monkeypatch.setattr(playback, "replay", lambda *found: asked.append(found) or iter(()))
    args = parser().parse_args(["render", str(tmp_path / "a.json"), "--out", str(tmp_path / "a.gif")])
    assert list(picture_commands._played(args)) == []
    (result, _, engine, _), *_ = asked
    assert (result, engine.policy_name) == (stored, GEOMETRIC)
