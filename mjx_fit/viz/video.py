"""Video of a recording: robot on the left, belief and measured force on the right."""

import os
import sys
import warnings
from collections.abc import Generator, Iterator
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import imageio_ffmpeg
import numpy as np
from jaxtyping import UInt8
from PIL import Image

from mjx_fit.evaluation.recording import Recording
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.utils import errors, files, locks
from mjx_fit.utils.errors import RequestError, WorkError
from mjx_fit.utils.progress import Progress
from mjx_fit.viz.camera import Stage
from mjx_fit.viz.panel import WIDTH_SHARE, Panel
from mjx_fit.viz.scene_model import Puppet
from mjx_fit.viz.timeline import Moment, moments, require_speed

FORMATS = (".mp4", ".gif")
SIZE_PX = (1280, 720)
MANY_FRAMES = 2000
"""Number of frames that takes minutes to render without a GPU."""
MOST_GIF_FRAMES, MOST_GIF_FPS = 1000, 50
"""Limits of a GIF: its clock ticks at 100 Hz, and all its frames are held in memory."""
Frame = UInt8[np.ndarray, "h w 3"]


def require(out: Path, fps: int, speed: float) -> None:
    """Refuse a video that cannot be made, before its assembly is simulated.

    Raises:
        RequestError: A value is invalid.
    """
    if out.suffix not in FORMATS:
        raise RequestError(f"--out: {out} is invalid: it must end in {' or '.join(FORMATS)}")
    errors.require("--fps", fps, 1, 60)
    require_speed(speed)
    if out.suffix == ".gif" and fps > MOST_GIF_FPS:
        raise RequestError(f"--fps: {fps} is out of range for a GIF: expected at most {MOST_GIF_FPS}")
    if out.is_dir():
        raise RequestError(f"--out: {out} cannot be used: it is a folder")
    files.require_writable(out)


def render(recording: Recording, out: Path, fps: int, speed: float, size: tuple[int, int] = SIZE_PX) -> Path:
    """Write the video of a recording atomically.

    Args:
        recording: Recording to show.
        out: An ``.mp4`` (H.264) or ``.gif``.
        fps: Frames per second.
        speed: Playback speed: seconds of an attempt per second of the video.
        size: Width and height, px; even numbers.

    Raises:
        RequestError: A value is invalid.
        WorkError: The encoder failed.
    """
    require(out, fps, speed)
    shown = moments(recording, fps, speed)
    require_few_frames(out, len(shown))
    if len(shown) > MANY_FRAMES:
        what = f"{len(shown)} frames for {len(recording.steps)} attempts"
        print(f"render: {what}; a higher --speed or a single --attempt needs fewer", file=sys.stderr)
    return write(_frames(recording, shown, size), out, fps, size)


def require_few_frames(out: Path, frames: int) -> None:
    """Refuse a GIF of more frames than memory should hold.

    Raises:
        RequestError: There are too many.
    """
    if out.suffix == ".gif" and frames > MOST_GIF_FRAMES:
        raise RequestError(
            f"--out: {out} cannot be used: a GIF of {frames} frames exceeds the limit of "
            f"{MOST_GIF_FRAMES}; use .mp4, --attempt, a lower --fps or a higher --speed"
        )


def write(frames: Generator[Frame], out: Path, fps: int, size: tuple[int, int]) -> Path:
    """Encode frames atomically, by the suffix of the file, and close them.

    Raises:
        WorkError: The encoder failed.
    """
    encode = _write_gif if out.suffix == ".gif" else _write_mp4
    # Close here: at process exit the graphics library that frees a context is already gone.
    with locks.holding_file(out), closing(frames):
        files.replace_with(out, lambda hidden: encode(frames, hidden, fps, size))
    return out


def still(recording: Recording, share: float, size: tuple[int, int] = SIZE_PX) -> Frame:
    """Return the video frame at a share of its length."""
    shown = moments(recording, 20, 8.0)
    return next(drawn(recording, [shown[round(share * (len(shown) - 1))]], size))


def _frames(recording: Recording, shown: list[Moment], size: tuple[int, int]) -> Generator[Frame]:
    with (
        Progress("rendering: frames", len(shown)) as progress,
        closing(drawn(recording, shown, size)) as images,
    ):
        for number, frame in enumerate(images, 1):
            yield frame
            progress(number)


def drawn(recording: Recording, shown: list[Moment], size: tuple[int, int]) -> Generator[Frame]:
    """Draw the frames of a recording, one for each moment."""
    width, height = size
    beside = round(width * WIDTH_SHARE)
    acting, panel = Puppet(recording), Panel(recording, beside, height)
    stage = Stage(acting, width - beside, height)
    scene = recording.config.scene
    corner = [0.72 * scene.plate_half_width_m, -0.72 * scene.plate_half_width_m, plate_top_m(scene)]
    numbers = np.pad(recording.hole_pos_world, ((0, 0), (0, 1))) + corner
    postures = acting.postures(np.stack([moment.tip_world for moment in shown]))
    try:
        for moment, qpos in zip(shown, postures, strict=True):
            step = recording.steps[moment.step]
            acting.pose(moment, step, qpos)
            image = stage.draw(moment)
            places = [stage.on_image(point) for point in numbers]
            image = panel.label(image, places, step.hole)
            yield np.concatenate([image, panel.draw(moment)], axis=1)
    finally:
        stage.close()


def _write_mp4(frames: Iterator[Frame], path: Path, fps: int, size: tuple[int, int]) -> None:
    writer = imageio_ffmpeg.write_frames(
        str(path),
        size,
        fps=fps,
        codec="libx264",
        output_params=["-preset", "fast", "-movflags", "+faststart", "-f", "mp4"],
        macro_block_size=2,
    )
    with warnings.catch_warnings():
        # JAX warns about any fork; this one executes the encoder immediately.
        warnings.filterwarnings("ignore", "os.fork", RuntimeWarning)
        writer.send(None)
    own = os.environ.get("IMAGEIO_FFMPEG_EXE")
    why = f", and does {own} (IMAGEIO_FFMPEG_EXE) support libx264?" if own else "?"
    failed = WorkError(f"render: the video could not be encoded completely: is there enough disk space{why}")
    sent = 0
    try:
        for frame in frames:
            writer.send(np.ascontiguousarray(frame))
            sent += 1
    except OSError:
        raise failed from None
    finally:
        writer.close()
    # The encoder may also stop early without an error, for example on a full disk: count its frames.
    try:
        encoded = imageio_ffmpeg.count_frames_and_secs(str(path))[0]
    except RuntimeError:
        encoded = None
    if encoded != sent:
        raise failed


def _write_gif(frames: Iterator[Frame], path: Path, fps: int, size: tuple[int, int]) -> None:
    images = [Image.fromarray(frame).quantize(128) for frame in frames]
    ends = [10 * round(100 * k / fps) for k in range(len(images) + 1)]  # ms, in whole hundredths
    lasts = [end - begin for begin, end in pairwise(ends)]
    images[0].save(path, "GIF", save_all=True, append_images=images[1:], duration=lasts, loop=0)
