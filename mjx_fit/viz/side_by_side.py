"""Video of two recordings side by side, with the seconds of their attempts and their largest force so far."""

from collections.abc import Generator
from contextlib import closing
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from mjx_fit.evaluation.recording import Recording
from mjx_fit.task.effort import forces_n
from mjx_fit.types import Felt
from mjx_fit.utils.progress import Progress
from mjx_fit.viz import video
from mjx_fit.viz.timeline import ACTIONS_PER_S, Moment, moments
from mjx_fit.viz.video import Frame

HALF_PX = (800, 450)
"""Size of each half, px."""
CAPTION_PX = 46
SIZE_PX = 2 * HALF_PX[0], HALF_PX[1] + CAPTION_PX


def render_beside(
    recordings: tuple[Recording, Recording], titles: tuple[str, str], out: Path, fps: int, speed: float
) -> Path:
    """Write the video of two recordings; the shorter one ends with a still picture.

    Args:
        recordings: What is shown on the left and on the right.
        titles: Their captions.
        out: An ``.mp4`` or ``.gif``.
        fps: Frames per second.
        speed: Playback speed: seconds of an attempt per second of the video.

    Raises:
        RequestError: A value is invalid.
        WorkError: The encoder failed.
    """
    video.require(out, fps, speed)
    shown = [moments(recording, fps, speed) for recording in recordings]
    most = max(map(len, shown))
    video.require_few_frames(out, most)
    halves = [_half(*one, most) for one in zip(recordings, titles, shown, strict=True)]

    def frames() -> Generator[Frame]:
        with Progress("rendering: frames", most) as progress, closing(halves[0]), closing(halves[1]):
            for number, pair in enumerate(zip(*halves, strict=True), 1):
                yield np.concatenate(pair, axis=1)
                progress(number)

    return video.write(frames(), out, fps, SIZE_PX)


def _half(recording: Recording, title: str, shown: list[Moment], most: int) -> Generator[Frame]:
    """Draw one half, with its caption, and hold its last frame."""
    seconds = [int(step.rollout.felt.length) / ACTIONS_PER_S for step in recording.steps]
    before = [0.0, *accumulate(seconds)]
    peaks = [_peaks_n(step.rollout.felt) for step in recording.steps]
    font = ImageFont.load_default(size=20)
    # Closing a renderer spoils the pictures of the other one: keep both to the end.
    with closing(video.drawn(recording, shown, HALF_PX)) as frames:
        frame = None
        for moment in shown:
            now = before[moment.step] + moment.actions / ACTIONS_PER_S
            so_far = [*peaks[: moment.step], peaks[moment.step][: int(np.ceil(moment.actions))]]
            most_n = max((float(own.max(initial=0)) for own in so_far), default=0.0)
            words = f"{title}:  {now:.1f} s of attempts,  at most {most_n:.0f} N"
            frame = np.concatenate([_caption(words, font), next(frames)])
            yield frame
        assert frame is not None
        for _ in range(most - len(shown)):
            yield frame


def _peaks_n(felt: Felt) -> np.ndarray:
    """Return the largest force of each action, N."""
    return forces_n(felt.trace.wrench_sensor, felt.tare_sensor).max(-1)[: int(felt.length)]


def _caption(words: str, font: Any) -> Frame:
    image = Image.new("RGB", (HALF_PX[0], CAPTION_PX), "#ffffff")
    ImageDraw.Draw(image).text((14, 10), words, fill="#1b1b1b", font=font)
    return np.asarray(image)
