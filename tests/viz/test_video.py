import dataclasses
import os
import subprocess
import sys
from typing import Any

import imageio_ffmpeg
import jax
import mujoco
import numpy as np
import pytest
from fakes import PathEngine
from PIL import Image
from synthetic import with_truth

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.config.sections.shape import SHAPES
from mjx_fit.evaluation import parts, playback, results
from mjx_fit.evaluation.assembly import assembly
from mjx_fit.evaluation.playback import Pick
from mjx_fit.evaluation.request import Request
from mjx_fit.scene.robot import PANDA
from mjx_fit.training.sensor_loader import TrainedSensor
from mjx_fit.utils import files
from mjx_fit.utils.errors import RequestError, WorkError
from mjx_fit.utils.type_colours import TYPE_RGB
from mjx_fit.viz import gl, video
from mjx_fit.viz.belief_marks import RADIUS_90, mixed
from mjx_fit.viz.panel import Panel
from mjx_fit.viz.scene_model import Puppet
from mjx_fit.viz.timeline import moments

TASK = dataclasses.replace(Config().task, n_holes=3, max_attempts=4)
CONFIG = dataclasses.replace(Config(), task=TASK)


def record(config, method, trial, seed, engine=None, attempt=None):
    """Plays all that is asked for."""
    *_, recording = playback.record(config, Pick(method, trial, attempt), seed, engine or PathEngine())
    return recording


def replay(result, method, trial, attempt=None):
    *_, recording = playback.replay(result, Pick(method, trial, attempt), PathEngine())
    return recording


@pytest.fixture
def played():
    return record(CONFIG, "failure_only", trial=1, seed=5)


@pytest.fixture
def result(monkeypatch, tmp_path):
    monkeypatch.setattr(parts, "ROWS", 4)  # two trials to a part: the third is in a part of its own
    methods = "failure_only,oracle"
    return assembly(Request(CONFIG, tmp_path / "assembly.json", PathEngine(), 3, 5, methods))


@pytest.mark.parametrize(("method", "trial"), [("failure_only", 2), ("oracle", 0), ("oracle", 2)])
def test_a_recording_is_the_experiments_trial(result, method, trial):
    row = next(row for row in result.trials if (row["method"], row["trial"]) == (method, trial))
    again = replay(result, method, trial)
    assert [step.hole for step in again.steps] == [hole for holes in row["tried"] for hole in holes]
    assert [SceneConfig().names[kind] for kind in again.peg_type] == row["pegs"]
    assert [SceneConfig().names[kind] for kind in again.hole_type] == row["holes"]
    assert [step.number for step in again.steps] == list(range(1, sum(row["attempts"]) + 1))
    assert [step.attempt for step in again.steps] == [k for n in row["attempts"] for k in range(1, n + 1)]
    assert sum(step.helped is not None for step in again.steps) == sum(row["human"])
    matches = [
        round(float(np.exp(step.before.type_logp[step.hole, again.peg_type[step.peg]])), 4)
        for step in again.steps
    ]
    assert matches == [match for peg in row["match_probability"] for match in peg]


def test_what_cannot_be_played_is_refused(result):
    with pytest.raises(RequestError, match="--method, --trial: full, 0"):
        replay(result, "full", 0)
    with pytest.raises(RequestError, match="trials 0 to 2"):
        replay(result, "oracle", 3)
    with pytest.raises(RequestError, match="'attempt' is invalid"):
        replay(dataclasses.replace(result, experiment="attempt"), "oracle", 0)
    for request in ({}, {"trials": "3"}, {"trials": 2}):
        with pytest.raises(RequestError, match=r"request\.trials"):
            replay(dataclasses.replace(result, request=request), "oracle", 0)
    for attempt in (0, 99):
        with pytest.raises(RequestError, match=rf"--attempt: {attempt} is out of range: .* 1 to \d+$"):
            replay(result, "oracle", 0, attempt=attempt)
        with pytest.raises(RequestError, match=f"--attempt: {attempt} is out of range: .* 1 to 12$"):
            record(CONFIG, "oracle", 0, 0, attempt=attempt)
    with pytest.raises(RequestError, match="trials cannot be used: the list is empty"):
        replay(dataclasses.replace(result, trials=[]), "oracle", 0)
    with pytest.raises(RequestError, match="--method: 'oracle,full' is invalid"):
        record(CONFIG, "oracle,full", 0, 0)
    result.trials[0]["tried"][0][0] += 1
    with pytest.raises(RequestError, match="differs from the result"):
        replay(result, "failure_only", 0)


def test_what_comes_after_the_attempt_in_question_is_not_played(result):
    row = next(row for row in result.trials if row["method"] == "failure_only" and sum(row["attempts"]) > 3)
    again = replay(result, "failure_only", row["trial"], attempt=2)
    tried = [hole for holes in row["tried"] for hole in holes]
    assert [step.hole for step in again.steps] == tried[:2]
    assert len(record(CONFIG, "failure_only", 1, 5, attempt=3).steps) == 3


def test_nothing_is_played_before_it_is_taken_nor_after_it_is_closed():
    engine = PathEngine()
    playing = playback.record(CONFIG, Pick("failure_only", 1), 5, engine)
    assert engine.seen == []
    assert [len(next(playing).steps), len(engine.seen)] == [1, 1]
    assert [len(next(playing).steps), len(engine.seen)] == [2, 2]
    playing.close()
    assert len(engine.seen) == 2


def test_a_result_is_replayed_with_the_sensor_that_it_was_made_with(result):
    network: Any = object()
    result.request["sensor"] = "made with"
    with pytest.raises(RequestError, match="--run: the result was made with another sensor"):
        playback.replay(result, Pick("oracle", 0), PathEngine(), TrainedSensor(network, CONFIG, "another"))
    again = playback.replay(
        result, Pick("oracle", 0), PathEngine(), TrainedSensor(network, CONFIG, "made with")
    )
    assert len(list(again)) == sum(result.trials[3]["attempts"])


def test_a_single_attempt_of_a_recording(played):
    assert [step.number for step in played.only(2).steps] == [2]
    with pytest.raises(RequestError, match=f"--attempt: 0 .* 1 to {len(played.steps)}"):
        played.only(0)


def test_the_tip_moves_without_jumps_through_what_was_recorded(played):
    shown = moments(played, fps=25, speed=0.1)
    tips = np.array([moment.tip_pos_world for moment in shown])
    assert np.linalg.norm(np.diff(tips, axis=0), axis=1).max() < 0.06
    assert np.allclose(tips[0], PANDA.home_m)
    for number, step in enumerate(played.steps):
        own = [m for m in shown if (m.step, m.phase) == (number, "attempt")]
        ways = np.array([moment.tip_pos_world[0] for moment in own]) - step.rollout.felt.estimate_world[0]
        assert (ways[0], ways[-1]) == pytest.approx((0, 0.004), abs=1e-6)
        half = min(own, key=lambda m: abs(m.actions - 1.0))  # the first action ends 2 mm further
        assert half.tip_pos_world[0] - step.rollout.felt.estimate_world[0] == pytest.approx(0.002, abs=2e-4)


def test_beliefs_turn_from_before_to_after_and_holes_stay_filled(played):
    shown = moments(played, fps=10, speed=1.0)
    for number, step in enumerate(played.steps):
        last = [m for m in shown if m.step == number][-1]
        assert np.allclose(last.belief.type_logp, step.after.type_logp, atol=1e-6)
    counts = [int(moment.filled.sum()) for moment in shown]
    assert counts == sorted(counts)
    assert counts[-1] == 3
    assert not shown[-1].holding


def test_a_belief_that_moves_inside_an_attempt_is_shown_as_it_moves(played):
    """As reported about the hole tried; the other holes keep theirs."""
    step = played.steps[0]
    length, rows = int(step.rollout.felt.length), len(step.rollout.felt.trace.action_world)
    told = jax.tree.map(
        lambda leaf: np.stack([leaf[step.hole] + 0.001 * j for j in range(rows)]), step.before
    )
    moving = dataclasses.replace(step, rollout=dataclasses.replace(step.rollout, report=told))
    shown = moments(dataclasses.replace(played, steps=(moving,)), fps=10, speed=1.0)
    during = [moment for moment in shown if moment.phase == "attempt"]
    assert len({float(moment.belief.pos_mean_world[step.hole, 0]) for moment in during}) > 1
    for moment in during:
        now = min(int(moment.actions), length - 1)
        np.testing.assert_allclose(moment.belief.pos_mean_world[step.hole], told.pos_mean_world[now])
        others = np.arange(3) != step.hole
        np.testing.assert_array_equal(moment.belief.pos_cov[others], step.before.pos_cov[others])
    first, last = (next(m for m in order if m.phase == "learn") for order in (shown, shown[::-1]))
    np.testing.assert_allclose(first.belief.pos_mean_world[step.hole], told.pos_mean_world[length - 1])
    np.testing.assert_allclose(last.belief.pos_mean_world[step.hole], step.after.pos_mean_world[step.hole])


def test_the_puppet_holds_its_tip_where_the_moment_says(played):
    puppet = Puppet(played)
    shown = moments(played, fps=4, speed=1.0)
    postures = puppet.postures(np.array([moment.tip_world for moment in shown]))
    for moment, qpos in zip(shown, postures, strict=True):
        puppet.pose(moment, played.steps[moment.step], qpos)
        assert np.allclose(puppet.data.site("tip").xpos, moment.tip_pos_world, atol=1e-4)
        held = {
            puppet.model.geom(i).name.split("_")[1]
            for i in range(puppet.model.ngeom)
            if puppet.model.geom(i).name.startswith("hand_") and puppet.model.geom_rgba[i, 3] > 0
        }
        peg = SceneConfig().names[played.peg_type[played.steps[moment.step].peg]]
        assert held == ({peg} if moment.holding else set())
    assert puppet.data.ncon == 0


def test_the_marks_are_the_regions_of_90_percent(played):
    puppet, moment = Puppet(played), moments(played, 4, 1.0)[0]
    cov = np.array([[4e-5, 1.2e-5], [1.2e-5, 1e-5]])
    belief = dataclasses.replace(moment.belief, cov=np.tile(cov, (3, 1, 1)))
    discs = puppet.marks(dataclasses.replace(moment, belief=belief))[::2]
    assert len(discs) == 3
    for disc in discs:
        axes = disc.frame_world[:2, :2] * disc.size[:2]
        assert np.allclose(axes @ axes.T, RADIUS_90**2 * cov, atol=1e-9)
        assert np.linalg.det(disc.frame_world) == pytest.approx(1)
    inside = np.random.default_rng(0).multivariate_normal([0, 0], cov, 20000)
    within = np.einsum("ni,ij,nj->n", inside, np.linalg.inv(axes @ axes.T), inside) <= 1
    assert within.mean() == pytest.approx(0.9, abs=0.01)


def test_colours_of_beliefs_go_from_pale_to_the_types_own():
    assert mixed(np.array([0.0, 1.0, 0.0])) == pytest.approx(TYPE_RGB[1])
    pale = mixed(np.array([1, 1, 1]) / 3)
    assert max(pale) - min(pale) < 0.05


@pytest.mark.parametrize("n", [1, 8])
def test_the_panel_has_room_for_any_number_of_holes(n):
    config = dataclasses.replace(CONFIG, task=dataclasses.replace(TASK, n_holes=n, max_attempts=1))
    played = record(config, "failure_only", 0, 0)
    panel, shown = Panel(played, 460, 720), moments(played, 4, 1.0)
    image = panel.draw(shown[0])
    assert image.shape == (720, 460, 3)
    assert (image[-1] == 255).all()
    assert (image[:, -1] == 255).all()
    sure = jax.tree.map(np.copy, shown[0].belief)
    sure.type_logp[0] = np.log([0.98, 0.01, 0.01])
    assert (panel.draw(dataclasses.replace(shown[0], belief=sure)) != image).any()
    assert [what for what, _ in panel.words(shown[-1])][2:] == [f"hole {k + 1}" for k in range(n)]


def test_a_peg_whose_name_begins_anothers_is_the_one_that_is_shown():
    shapes = tuple(dataclasses.replace(s, name=n) for s, n in zip(SHAPES, ("ell_0", "ell", "o"), strict=True))
    config = dataclasses.replace(CONFIG, scene=dataclasses.replace(CONFIG.scene, shapes=shapes))
    played = record(config, "failure_only", 1, 5)
    puppet, shown = Puppet(played), moments(played, 4, 1.0)
    for moment in shown:
        step = played.steps[moment.step]
        puppet.pose(moment, step, np.zeros(7))
        boxes = [i for i in range(puppet.model.ngeom) if puppet.model.geom(i).name.startswith("hand_")]
        seen = sum(puppet.model.geom_rgba[i, 3] for i in boxes)
        assert seen == (len(shapes[played.peg_type[step.peg]].rectangles) if moment.holding else 0)


class BreakingEngine(PathEngine):
    """Every attempt breaks in its second action."""

    def run(self, attempts, actions=None, active=None, horizon=None):
        done = super().run(attempts, actions, active, horizon)
        done.felt.trace.tip_pos_world[:, 1] = np.nan
        done.felt.trace.wrench_sensor[:, 1] = [np.nan, np.inf, 1e30, 0, 0, 0]
        none = np.zeros(len(done.felt.length), bool)
        return with_truth(done, valid=none, inserted=none)


def test_a_world_that_broke_is_shown_as_far_as_it_went():
    played = record(CONFIG, "failure_only", 0, 0, BreakingEngine())
    shown = moments(played, 4, 1.0)
    assert all(np.isfinite(moment.tip_pos_world).all() for moment in shown)
    panel = Panel(played, 460, 720)
    assert ("attempt 1", "simulation diverged; no belief update") in [
        words for moment in shown for words in panel.words(moment)
    ]
    for moment in shown[::7]:
        panel.draw(moment)


def test_values_that_make_no_video(played, tmp_path):
    for values, word in (((tmp_path / "a.avi", 20, 8.0), "--out"), ((tmp_path / "a.mp4", 0, 8.0), "--fps")):
        with pytest.raises(RequestError, match=word):
            video.render(played, *values)
    with pytest.raises(RequestError, match="for a GIF: expected at most 50"):
        video.render(played, tmp_path / "a.gif", 60, 8.0)
    (tmp_path / "b.gif").mkdir()
    with pytest.raises(RequestError, match="it is a folder"):
        video.render(played, tmp_path / "b.gif", 20, 8.0)
    (tmp_path / "b.gif").rmdir()
    with pytest.raises(RequestError, match=r"a GIF of \d+ frames"):
        video.render(played, tmp_path / "a.gif", 50, 0.1)
    with pytest.raises(RequestError, match="--speed"):
        video.render(played, tmp_path / "a.gif", 20, 0.0)
    assert not list(tmp_path.iterdir())


def run(*words, **environment):
    return subprocess.run(
        [sys.executable, "-m", "mjx_fit", *words],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )


def test_what_cannot_draw_is_one_line(tmp_path):
    done = run("render", "--out", str(tmp_path / "a.gif"), MUJOCO_GL="glx")
    assert done.returncode == 2
    assert done.stderr.startswith("mjx-fit: MUJOCO_GL: 'glx' cannot be used")
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def drawing():
    """A backend that draws here, if there is one."""
    found = [name for name in gl.BACKENDS if gl.draws(name)]
    if not found:
        pytest.skip("no OpenGL here")
    return found[0]


def test_a_video_from_command_to_file(tmp_path, drawing):
    out = tmp_path / "one.gif"
    small = ("--set", "task.n_holes=1", "--set", "task.max_attempts=1", "--set", "task.attempt_actions=3")
    done = run(
        "render", "--out", str(out), "--method", "failure_only", *small, "--fps", "4", MUJOCO_GL=drawing
    )
    assert done.returncode == 0, done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["one.gif"]
    with Image.open(out) as image:
        assert image.size == video.SIZE_PX
        frames = []
        for index in range(getattr(image, "n_frames", 1)):
            image.seek(index)
            frames.append(np.asarray(image.convert("RGB"), float))
    assert len(frames) >= 4
    robot, panel = np.split(np.array([frame.mean(2) for frame in (frames[0], frames[-1])]), [800], axis=2)
    assert robot.std() > 20
    assert np.abs(np.diff(robot, axis=0)).max() > 50
    assert panel.mean() > 200


def test_an_mp4_holds_every_frame_and_a_failed_encoder_leaves_the_old_file(tmp_path):
    noise = np.random.default_rng(0).integers(0, 255, (9, 48, 64, 3), np.uint8)
    path = tmp_path / "a.mp4"
    video._write_mp4(iter(noise), path, 10, (64, 48))
    assert imageio_ffmpeg.count_frames_and_secs(str(path))[0] == 9
    before = path.read_bytes()
    with pytest.raises(
        WorkError, match=r"^render: the video could not be encoded completely: is there enough disk space\?$"
    ):
        files.replace_with(path, lambda hidden: video._write_mp4(iter(noise), hidden / "no", 10, (64, 48)))
    assert path.read_bytes() == before
    assert [each.name for each in tmp_path.iterdir()] == ["a.mp4"]


def test_a_point_of_the_world_lies_where_it_is_drawn(drawing):
    script = """
import numpy as np
from mjx_fit.viz.camera import Stage
import mujoco
class Bare:
    model = mujoco.MjModel.from_xml_string('<mujoco><worldbody><light pos="0 0 3"/>'
        '<geom type="sphere" size="0.02" pos="0.5 0.1 0.05" rgba="1 0 0 1"/></worldbody></mujoco>')
    data = mujoco.MjData(model)
    def marks(self, moment): return []
mujoco.mj_forward(Bare.model, Bare.data)
stage = Stage(Bare(), 640, 480)
red = stage.draw(None)[..., 0] > 60
y, x = np.argwhere(red).mean(0)
print(np.hypot(*np.subtract(stage.on_image(np.array([0.5, 0.1, 0.05])), (x, y))))
stage.close()
"""
    done = subprocess.run(
        [sys.executable, "-c", script],
        env=os.environ | {"MUJOCO_GL": drawing},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) < 2.0


def test_results_and_own_settings_do_not_mix(result, tmp_path):
    out = tmp_path / "result.json"
    results.write(out, result)
    done = run("view", str(out), "--seed", "3")
    assert done.returncode == 2
    assert "cannot be combined with a result file" in done.stderr
    done = run("view", str(out), "--world", "paper")
    assert done.returncode == 2
    assert "--world" in done.stderr
    assert mujoco.__version__ in result.versions.values()
