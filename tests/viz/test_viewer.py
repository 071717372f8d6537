import sys
from contextlib import contextmanager
from types import SimpleNamespace

import mujoco
import mujoco.viewer
import numpy as np
import pytest
from fakes import TWO_HOLES as CONFIG
from fakes import PathEngine

from mjx_fit.evaluation import playback
from mjx_fit.utils.errors import RequestError
from mjx_fit.viz import viewer
from mjx_fit.viz.mujoco_window import Window
from mjx_fit.viz.panel import Panel
from mjx_fit.viz.scene_model import Puppet
from mjx_fit.viz.timeline import moments


def play(attempt=None):
    return playback.record(CONFIG, playback.Pick("failure_only", 1, attempt), 5, PathEngine())


def whole():
    *_, recording = play()
    return recording


class Screen:
    """Keeps what it was shown; is closed after so many pictures, or once nothing new has come for a while."""

    def __init__(self, puppet, pictures):
        self.puppet, self.pictures, self.shown, self.off_m, self.idle = puppet, pictures, [], [], 0

    def show(self, pose, moment, words, panel):
        pose()
        self.idle = 0
        self.shown.append((moment.step, moment.phase, dict(words)))
        self.off_m.append(np.abs(self.puppet.data.site("tip").xpos - moment.tip_pos_world).max())

    def is_open(self):
        self.idle += 1
        return len(self.shown) < self.pictures and self.idle < 6


@pytest.fixture
def screens(monkeypatch):
    """Opens such a screen in the window's place."""
    opened = []

    def opens(pictures=10_000):
        monkeypatch.setattr(viewer, "_has_display", lambda: True)
        monkeypatch.setattr(
            viewer, "_open_window", lambda puppet: opened.append(Screen(puppet, pictures)) or opened[-1]
        )
        return opened

    return opens


def test_every_attempt_is_shown_in_order_until_it_is_closed(screens):
    steps = whole().steps
    opened = screens()
    viewer.view(play(), None, 100.0, False, 8080)
    (screen,) = opened
    order = [step for step, _, _ in screen.shown]
    assert order == sorted(order)
    assert set(order) == set(range(len(steps)))
    for number, step in enumerate(steps):
        phase, words = [(phase, words) for at, phase, words in screen.shown if at == number][-1]
        assert phase == "learn"
        assert words[f"attempt {step.attempt}"].startswith("inserted") == bool(step.rollout.truth.inserted)
    assert max(screen.off_m) < 1e-4


def test_one_attempt_is_shown_alone_and_what_comes_later_is_not_played(screens):
    opened, played = screens(), []
    viewer.view((played.append(so_far) or so_far for so_far in play(2)), 2, 100.0, False, 8080)
    assert {step for step, _, _ in opened[0].shown} == {1}
    assert len(played) == 2


def test_it_is_looked_at_once_the_playing_is_over(screens):
    """Playing has a watchdog, which takes whoever looks for long for work that stands still."""
    opened, looked = screens(), []

    def playing():
        yield from play(2)
        looked.append(opened[0].idle)

    viewer.view(playing(), 2, 100.0, False, 8080)
    assert looked == [1]  # asked once, after the last picture
    assert opened[0].idle == 6


@pytest.mark.parametrize(
    ("browser", "why"), [(True, "--browser needs"), (False, "without a display it needs")]
)
def test_no_browser_is_one_line_that_says_what_to_install(monkeypatch, browser, why):
    monkeypatch.setitem(sys.modules, "viser", None)
    monkeypatch.delitem(sys.modules, "mjx_fit.viz.viser_page", raising=False)
    monkeypatch.setattr(viewer, "_has_display", lambda: False)
    with pytest.raises(RequestError, match=rf"view: {why} viser, .*pip install 'mjx-fit\[view\]'$"):
        viewer.view(play(), None, 1.0, browser, 8080)


def test_a_closed_screen_ends_the_show(screens):
    opened = screens(pictures=3)
    viewer.view(play(), None, 100.0, False, 8080)
    assert len(opened[0].shown) == 3


def test_an_attempt_that_there_is_not_is_refused(screens):
    screens()
    with pytest.raises(RequestError, match="--attempt: 99 is out of range"):
        viewer.view(play(), 99, 100.0, False, 8080)


@pytest.mark.parametrize(("speed", "port", "word"), [(0.0, 8080, "--speed: 0.0"), (1.0, 0, "--port: 0")])
def test_values_that_show_nothing(speed, port, word):
    with pytest.raises(RequestError, match=f"{word} is out of range"):
        viewer.view(play(), None, speed, True, port)


class Viewer:
    """In the place of MuJoCo's passive viewer."""

    def __init__(self, model):
        self.user_scn = mujoco.MjvScene(model, 100)
        self.cam, self.locked, self.texts, self.synced = mujoco.MjvCamera(), False, [], 0

    @contextmanager
    def lock(self):
        self.locked = True
        yield
        self.locked = False

    def set_texts(self, texts):
        assert not self.locked  # it takes the lock itself
        self.texts = list(texts)

    def sync(self):
        self.synced += 1

    def is_running(self):
        return True


def test_the_window_poses_under_the_viewers_lock(monkeypatch):
    played = whole()
    puppet, shown = Puppet(played), moments(played, 4, 1.0)
    viewer = Viewer(puppet.model)
    monkeypatch.setattr(mujoco, "viewer", SimpleNamespace(launch_passive=lambda *_, **__: viewer))
    window, panel, held = Window(puppet), Panel(played, 460, 720), []
    for moment in (shown[0], shown[-1]):
        window.show(lambda: held.append(viewer.locked), moment, panel.words(moment), np.zeros(()))
        assert viewer.user_scn.ngeom == 2 * (~moment.filled).sum()
        assert "hole 1" in viewer.texts[2]
    assert held == [True, True]
    assert viewer.synced == 2


def test_the_browser_shows_the_arm_and_the_marks_where_they_are():
    pytest.importorskip("viser")
    from mjx_fit.viz.viser_access import Door
    from mjx_fit.viz.viser_page import Browser

    played = whole()
    puppet, shown = Puppet(played), moments(played, 4, 1.0)
    browser, panel = Browser(puppet, Door("127.0.0.1", 8123)), Panel(played, 460, 720)
    try:
        for moment in (shown[0], shown[-1]):
            qpos = puppet.postures(moment.tip_world[None])[0]
            browser.show(
                lambda moment=moment, qpos=qpos: puppet.pose(moment, played.steps[moment.step], qpos),
                moment,
                panel.words(moment),
                panel.draw(moment),
            )
            for i, handle in browser._geoms.items():
                assert np.allclose(handle.position, puppet.data.geom_xpos[i], atol=1e-6)
            seen = [mark for mark in browser._marks.values() if mark.visible]
            assert len(seen) == 2 * (~moment.filled).sum()
    finally:
        browser._server.stop()
