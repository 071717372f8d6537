"""Live view of an assembly: in MuJoCo's viewer if there is a display, or in a browser."""

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
    """Interface of a screen that shows a puppet."""

    def show(
        self, pose: Callable[[], None], moment: Moment, words: list[tuple[str, str]], panel: np.ndarray
    ) -> None:
        """Pose the puppet, and show it with the marks of the moment, next to the text or the panel.

        Args:
            pose: Function that poses it; a screen that draws in another thread blocks that thread meanwhile.
            moment: Moment to show.
            words: Belief and progress as text, in two columns.
            panel: The same as an image.
        """
        ...

    def is_open(self) -> bool:
        """Return whether the screen is still open."""
        ...


def view(
    played: Generator[Recording],
    attempt: int | None,
    speed: float,
    browser: bool,
    port: int,
    host: str = "127.0.0.1",
) -> None:
    """Show each attempt of an assembly as soon as it is simulated; the screen stays open at the end.

    Args:
        played: Generator of the recording after each attempt; closed at the end.
        attempt: Number of the only attempt to show; None shows all.
        speed: Playback speed: seconds of an attempt per second of the view.
        browser: True to use a browser even if there is a display.
        port: Port of the browser's page.
        host: Address or name of this machine at which the page is served; the loopback is local only.

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
    interrupts.settle()  # closing the view is a regular end


def _show_all(played: Generator[Recording], show: "_Show", attempt: int | None) -> None:
    """Show the recording until the screen is closed."""
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
    """Open a screen at the first attempt, and show each attempt in real time."""

    def __init__(self, open_screen: Callable[[Puppet], Screen], speed: float, attempt: int | None):
        self._open, self._speed, self._attempt = open_screen, speed, attempt
        self._puppet: Puppet | None = None
        self._screen: Screen | None = None

    def is_open(self) -> bool:
        """Return whether the screen is open."""
        return self._screen is not None and self._screen.is_open()

    def latest(self, recording: Recording) -> bool:
        """Show the latest attempt of a recording, if selected; return False once the screen is closed."""
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
                continue  # a slow screen drops frames instead of lagging
            qpos = self._puppet.postures(moment.tip_world[None])[0]
            pose = partial(self._puppet.pose, moment, step, qpos)
            self._screen.show(pose, moment, panel.words(moment), panel.draw(moment))
            if not self._screen.is_open():
                return False
            time.sleep(max(0.0, began + (number + 1) / FPS - time.monotonic()))
        self._tip = shown[-1].tip_world
        return True


def _has_display() -> bool:
    """Return whether MuJoCo's viewer can open; on macOS it would need ``mjpython``."""
    if sys.platform == "darwin":
        return False
    if sys.platform == "win32":
        return True
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return False
    # The viewer would wait forever for a display that is set but dead.
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
    door = Door(host, port)  # before anything is simulated
    if not door.is_loopback:
        print(f"--host {host}: anybody who reaches port {port} of it can watch", file=sys.stderr, flush=True)
    return lambda puppet: Browser(puppet, door)
