"""NOTICE agrees with what the installed programs and packages state about their licences."""

import re
import subprocess
import sys
from importlib.metadata import distribution

import imageio_ffmpeg
import numpy as np
import pytest
from fakes import TWO_HOLES as CONFIG
from fakes import PathEngine
from test_package import ROOT

from mjx_fit.evaluation import playback
from mjx_fit.utils.errors import WorkError
from mjx_fit.viz import video

NOTICE = " ".join((ROOT / "NOTICE").read_text().split())


def test_it_names_the_licence_that_the_bundled_ffmpeg_states(monkeypatch):
    monkeypatch.delenv("IMAGEIO_FFMPEG_EXE", raising=False)
    program = imageio_ffmpeg.get_ffmpeg_exe()
    told = subprocess.run([program, "-version"], capture_output=True, text=True, check=True).stdout
    licence = subprocess.run([program, "-L"], capture_output=True, text=True, check=True)
    for option in re.findall(r"--enable-(?:gpl|version3|nonfree)\b", told):
        assert option in NOTICE
    stated = " ".join((licence.stdout + licence.stderr).split())
    found = sys.platform == "linux" and re.search(
        r"GNU General Public License .*?version (\d) of the License, or", stated
    )
    if found:
        assert f"GNU General Public License, version {found[1]} or later" in NOTICE


@pytest.mark.parametrize(
    "word", ["separate program", "IMAGEIO_FFMPEG_EXE", "--no-binary imageio-ffmpeg", "linked"]
)
def test_it_says_what_ffmpeg_is_for_and_how_to_do_without(word):
    assert word in NOTICE


def test_it_names_the_licences_of_what_brings_parts_of_third_parties():
    files = [str(path) for path in distribution("mujoco").files or ()]
    assert any(path.endswith("LICENSES_THIRD_PARTY.md") for path in files)
    assert "MuJoCo and MJX (Apache-2.0)" in NOTICE
    pytest.importorskip("viser")
    assert re.search(r"^License.*MIT", distribution("viser").read_text("METADATA") or "", re.MULTILINE)
    assert "viser (MIT)" in NOTICE


def test_an_ffmpeg_of_ones_own_that_does_not_do_is_one_line_and_leaves_nothing(tmp_path, monkeypatch):
    closed = []

    def drawn(recording, shown, size):
        try:
            while True:
                yield np.zeros((size[1], size[0], 3), np.uint8)
        finally:
            closed.append(True)

    monkeypatch.setattr(video, "drawn", drawn)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", "/bin/false")
    *_, played = playback.record(CONFIG, playback.Pick("failure_only", 1), 5, PathEngine())
    with pytest.raises(
        WorkError, match=r"does /bin/false \(IMAGEIO_FFMPEG_EXE\) support libx264\?$"
    ) as caught:
        video.render(played, tmp_path / "a.mp4", 10, 8.0, (640, 480))
    assert "\n" not in str(caught.value)
    assert closed
    assert not list(tmp_path.glob("*.mp4"))
