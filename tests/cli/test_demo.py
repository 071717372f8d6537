import json
from pathlib import Path

import pytest

from mjx_fit.cli.demo import Size, run_demo
from mjx_fit.config.files import read_config, read_tree
from mjx_fit.evaluation import results
from mjx_fit.utils import resources

TINY = [
    "sensor.width=8", "sensor.layers=1", "sensor.feedforward=8", "sensor.conv_channels=[4, 4, 4, 4, 4]",
    "train.epochs=2", "train.batch_size=8", "train.max_window=20", "task.attempt_actions=6",
    "task.max_attempts=2", "task.n_holes=2", "train.baseline_share=0",
    "sensor.noise=peg", "sensor.contact_features=false", "sensor.places=0", "train.mirror=false",
]  # fmt: skip


@pytest.fixture
def video(monkeypatch):
    """Drawing is tested elsewhere; here is what the command was, and a file."""
    asked = []

    def pretend(words):
        asked.append(words)
        Path(words[words.index("--out") + 1]).write_bytes(b"\0\0\0\x20ftypisom")
        return 0

    monkeypatch.setattr("mjx_fit.cli.demo.children.run", pretend)
    return asked


@pytest.mark.slow
def test_demo_plays_with_the_weights_that_come_with_it(tmp_path, capsys, video):
    out = tmp_path / "demo"
    small = ["task.attempt_actions=6", "task.max_attempts=2", "task.n_holes=2"]
    run_demo(read_config(None, small), out, Size(assemblies=2), train=False)
    assert "full" in capsys.readouterr().out
    made = {"assembly.json", "seek.json", "assembly.mp4", "figures", "index.html"}
    assert {path.name for path in out.iterdir()} == made
    sought = results.read(out / "seek.json")
    assert sought.request["policy"].startswith("seek@")
    for section, keys in read_tree(resources.folder("configs") / "gentle.yaml").items():
        assert {key: sought.config[section][key] for key in keys} == keys
    page = (out / "index.html").read_text()
    assert page.index("<video") < page.index("<figure")
    assert "Hardest of 2 assemblies with full" in page
    assert len(video) == 1
    run_demo(read_config(None, small), out, Size(assemblies=2), train=False)
    assert len(video) == 1


@pytest.mark.slow
def test_without_a_video_the_demo_has_everything_else(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("mjx_fit.cli.demo.children.run", lambda words: 2)
    small = ["task.attempt_actions=6", "task.max_attempts=1", "task.n_holes=1"]
    run_demo(read_config(None, small), tmp_path / "demo", Size(assemblies=1), train=False)
    assert "the video failed" in capsys.readouterr().out
    assert "<video" not in (tmp_path / "demo" / "index.html").read_text()


def test_demo_makes_every_stage_and_a_repeat_changes_nothing(tmp_path, capsys, video):
    out = tmp_path / "demo"
    size = Size(episodes=8, steps=6, assemblies=2)
    run_demo(read_config(None, TINY), out, size, train=True)
    told = capsys.readouterr().out
    assert "95 % interval" in told
    assert "validation NLL" in told
    page = (out / "index.html").read_text()
    assert page.count("<figure") >= 3
    methods = {trial["method"] for trial in results.read(out / "assembly.json").trials}
    assert methods == {"failure_only", "full", "oracle"}
    stages = ("data/manifest.json", "train/metrics.jsonl", "assembly.json", "assembly.mp4")
    stamps = [(out / name).stat().st_mtime_ns for name in stages]
    run_demo(read_config(None, TINY), out, size, train=True)
    assert stamps == [(out / name).stat().st_mtime_ns for name in stages]
    assert (out / "index.html").read_text() == page


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_demo_learns(tmp_path, video):
    """At its real size, data and training alone: the updated belief beats the prior on held-out episodes."""
    out = tmp_path / "demo"
    settings = read_config(resources.folder("configs") / "quick.yaml")
    run_demo(settings, out, Size(assemblies=1), train=True)
    rows = [json.loads(line) for line in (out / "train" / "metrics.jsonl").read_text().splitlines()]
    assert min(row["val_nll"] for row in rows) < rows[0]["prior_nll"] - 0.5
