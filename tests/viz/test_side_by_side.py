"""Two recordings in one video: as long as the longer one, each under its caption."""

import numpy as np
import pytest
from fakes import PathEngine
from test_video import CONFIG, record

from mjx_fit.utils.errors import RequestError
from mjx_fit.viz import side_by_side, video
from mjx_fit.viz.side_by_side import CAPTION_PX, HALF_PX, SIZE_PX, render_beside
from mjx_fit.viz.timeline import moments

closed_after = []
"""Frames that were encoded before each renderer was closed."""


@pytest.fixture
def frames(monkeypatch):
    """What would be encoded, drawn as the number of each moment."""
    kept = []
    closed_after.clear()

    def drawn(recording, shown, size):
        try:
            for number in range(len(shown)):
                yield np.full((size[1], size[0], 3), number % 250, np.uint8)
        finally:
            closed_after.append(len(kept))

    monkeypatch.setattr(video, "drawn", drawn)

    def write(found, out, fps, size):
        for frame in found:
            kept.append(frame)
        return out

    monkeypatch.setattr(video, "write", write)
    return kept


def test_the_shorter_one_ends_with_a_still_picture(frames, tmp_path):
    pair = record(CONFIG, "oracle", 1, 5), record(CONFIG, "failure_only", 1, 5, PathEngine())
    short, long = (len(moments(one, 4, 2.0)) for one in pair)
    assert short < long < 250
    render_beside(pair, ("left", "right"), tmp_path / "a.mp4", 4, 2.0)
    assert len(frames) == long
    # A closed renderer would spoil the pictures of the other one.
    assert closed_after == [long, long]
    width = HALF_PX[0]
    for number, frame in enumerate(frames):
        assert frame.shape == (*SIZE_PX[::-1], 3)
        left, right = frame[CAPTION_PX + 5, [5, width + 5], 0]
        assert (left, right) == (min(number, short - 1), number)
        for side in (frame[:CAPTION_PX, :width], frame[:CAPTION_PX, width:]):
            assert side.min() < 100
            assert side.max() == 255


def test_captions_tell_seconds_and_the_largest_force_so_far(frames, monkeypatch, tmp_path):
    told = []

    def caption(words, font):
        told.append(words)
        return np.zeros((CAPTION_PX, HALF_PX[0], 3), np.uint8)

    monkeypatch.setattr(side_by_side, "_caption", caption)
    one = record(CONFIG, "failure_only", 1, 5)
    render_beside((one, one), ("a", "b"), tmp_path / "a.mp4", 4, 2.0)
    seconds = sum(int(step.rollout.felt.length) for step in one.steps) / 10
    assert told[0].startswith("a:  0.0 s of attempts")
    assert told[-1].startswith(f"b:  {seconds:.1f} s of attempts")


def test_a_gif_without_end_is_refused_before_anything_is_drawn(frames, tmp_path):
    one = record(CONFIG, "failure_only", 1, 5)
    with pytest.raises(RequestError, match="GIF of"):
        render_beside((one, one), ("a", "b"), tmp_path / "a.gif", 50, 0.1)
    assert not frames
