"""The paper's command, as small as it gets, and killed in between."""

import pytest

from mjx_fit import config, resources
from mjx_fit.errors import RequestError
from mjx_fit.evaluation import results
from mjx_fit.paper import RESULTS, SIZES, Size, paper, size_of

TINY = [
    "sensor.width=8", "sensor.layers=1", "sensor.feedforward=8", "sensor.conv_channels=[4, 4, 4, 4, 4]",
    "train.epochs=2", "train.batch_size=8", "train.max_window=20", "train.baseline_share=0.5",
    "task.attempt_actions=6", "task.max_attempts=2", "task.n_holes=2",
]  # fmt: skip
SIZE = Size("cpu", 12, 3, 12, 15, 2, 2, 2, 2, 2, 3)


class KilledError(Exception):
    """Stands for a kill."""


def test_every_stage_is_done_once_and_a_kill_goes_on(tmp_path, monkeypatch, capsys):
    settings = config.load(None, TINY)
    out = tmp_path / "paper"

    def killed(*args):
        raise KilledError

    with monkeypatch.context() as patch:
        patch.setattr("mjx_fit.paper.insertion", killed)
        with pytest.raises(KilledError):
            paper(settings, out, SIZE, 0)
    assert not (out / "insertion.json").exists()
    done = {path: path.stat().st_mtime_ns for path in [*out.glob("*.json"), *(out / "data").iterdir()]}
    assert len(done) > 5
    paper(settings, out, SIZE, 0)
    assert {path: path.stat().st_mtime_ns for path in done} == done
    told = capsys.readouterr().out
    assert "minutes" in told
    assert "here, at" in told
    found = {path.stem: results.read(path).experiment for path in out.glob("*.json")}
    assert found == {name: name.split("_")[0] for name in RESULTS}
    methods = {trial["method"] for trial in results.read(out / "insertion.json").trials}
    assert methods == {"full", "no_update", "sample", "frame_by_frame", "oracle"}
    assert not list(out.glob("*.parts"))
    page = (out / "report" / "index.html").read_text()
    assert page.count("<figure") >= 20


def test_sizes_have_names_and_presets_that_can_be_compared(tmp_path):
    for name, size in SIZES.items():
        assert size_of(name) == size
        assert config.load(resources.folder("configs") / f"{size.preset}.yaml").train.baseline_share > 0
        for count in (size.episodes / size.sequence, size.own / 5):
            assert count == int(count)
    with pytest.raises(RequestError, match="it must be above 0"):
        paper(config.load(None, [*TINY, "train.baseline_share=0"]), tmp_path / "p", SIZE, 0)
    (tmp_path / "mine.json").write_text("{}")
    with pytest.raises(RequestError, match="it holds other files"):
        paper(config.load(None, TINY), tmp_path, SIZE, 0)
    with pytest.raises(RequestError, match="--size: 'huge' is not allowed: choose from quick, cpu, full"):
        size_of("huge")
