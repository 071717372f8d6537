"""Watching an assembly as it is played: in MuJoCo's viewer where there is a display, or in a browser."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from contextlib import closing, suppress
from functools import partial
from typing import Protocol

import numpy as np

from mjx_fit.evaluation.recording import Recording
from mjx_fit.utils import interrupts
from mjx_fit.utils.errors import RequestError, require
from mjx_fit.viz.panel import Panel
from mjx_fit.viz.scene_model import Puppet
from mjx_fit.viz.timeline import Moment, home, moments_of, require_speed

FPS = 25
PANEL_PX = (460, 720)


class Screen(Protocol):
    """What shows a puppet to somebody."""

    def show(
        self, pose: Callable[[], None], moment: Moment, words: list[tuple[str, str]], panel: np.ndarray
    ) -> None:
        """Poses the puppet, and shows it with the marks of the moment and, beside them, words or the panel.

        Args:
            pose: Poses it; a screen that draws from another thread holds that one meanwhile.
            moment: What is shown.
            words: What is believed and done, in two columns.
            panel: The same as a picture.
        """
        ...

    def is_open(self) -> bool:
        """Whether anybody can still look."""
        ...


def view(
    played: Generator[Recording],
    attempt: int | None,
    speed: float,
    browser: bool,
    port: int,
    host: str = "127.0.0.1",
) -> None:
    """Shows every attempt of an assembly once it has been simulated; stays open at the end.

    Args:
        played: Plays as far as is shown: after every attempt, what was played so far. Closed at the end.
        attempt: Show only the one with this number.
        speed: Seconds of an attempt in a second of the show.
        browser: Whether to show it in a browser though there is a display.
        port: Of the browser's page.
        host: Address or name of this machine at which the page is served; nobody else reaches the loop-back.

    Raises:
        RequestError: A value is invalid, the port is in use, or there is neither a display nor viser.
    """
    require_speed(speed)
    require("--port", port, 1, 65535)
    opens = _open_window
    if browser or not _has_display():
        opens = _open_browser(host, port, "--browser" if browser else "without a display it")
    show = _Show(opens, speed, attempt)
    with suppress(KeyboardInterrupt):
        _show_all(played, show, attempt)
    interrupts.settle()  # to close it is what was asked for


def _show_all(played: Generator[Recording], show: "_Show", attempt: int | None) -> None:
    """Shows what is played until nobody looks any more."""
    recording = None
    with closing(played):
        for recording in played:
            if not show.latest(recording):
                return
    if recording is not None and attempt is not None:
        recording.only(attempt)
    while show.is_open():
        time.sleep(0.2)


class _Show:
    """Opens a screen at the first attempt, and shows each in the time that it takes."""

    def __init__(self, open_screen: Callable[[Puppet], Screen], speed: float, attempt: int | None):
        self._open, self._speed, self._attempt = open_screen, speed, attempt
        self._puppet: Puppet | None = None
        self._screen: Screen | None = None

    def is_open(self) -> bool:
        """Whether anybody looks."""
        return self._screen is not None and self._screen.is_open()

    def latest(self, recording: Recording) -> bool:
        """Shows the latest attempt of a recording, if it is one to be shown; gives whether anybody looks."""
        if self._puppet is None or self._screen is None:
            self._puppet = Puppet(recording)
            self._tip = home(recording)
            self._screen = self._open(self._puppet)
        if not self._screen.is_open():
            return False
        step = recording.steps[-1]
        if self._attempt not in (None, step.number):
            return True
        shown = moments_of(recording, len(recording.steps) - 1, self._tip, FPS, self._speed)
        panel = Panel(recording, *PANEL_PX)
        began = time.monotonic()
        for number, moment in enumerate(shown):
            late = time.monotonic() - began - number / FPS
            if late > 1 / FPS and number < len(shown) - 1:
                continue  # a slow screen drops frames, it does not run late
            qpos = self._puppet.postures(moment.tip_pos_world[None])[0]
            pose = partial(self._puppet.pose, moment, step, qpos)
            self._screen.show(pose, moment, panel.words(moment), panel.draw(moment))
            if not self._screen.is_open():
                return False
            time.sleep(max(0.0, began + (number + 1) / FPS - time.monotonic()))
        self._tip = shown[-1].tip_pos_world
        return True


def _has_display() -> bool:
    """Whether MuJoCo's viewer can open: on a Mac it would have to own the process (``mjpython``)."""
    if sys.platform == "darwin":
        return False
    if sys.platform == "win32":
        return True
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return False
    # A display that is named but dead would let the viewer wait for ever.
    opens = "import glfw, sys; sys.exit(not glfw.init())"
    return subprocess.run([sys.executable, "-c", opens], capture_output=True, check=False).returncode == 0


def _open_window(puppet: Puppet) -> Screen:
    from mjx_fit.viz.mujoco_window import Window

    return Window(puppet)


def _open_browser(host: str, port: int, what: str) -> Callable[[Puppet], Screen]:
    try:
        from mjx_fit.viz.viser_access import Door
        from mjx_fit.viz.viser_page import Browser
    except ImportError:
        raise RequestError(
            f"view: {what} needs viser, which is not installed: pip install 'mjx-fit[view]'"
        ) from None
    door = Door(host, port)  # before anything is played
    if not door.is_loopback:
        print(f"--host {host}: anybody who reaches port {port} of it can look", file=sys.stderr, flush=True)
    return lambda puppet: Browser(puppet, door)
