import json

import pytest

from mjx_fit import config, resources
from mjx_fit.demo import Size, demo
from mjx_fit.evaluation import results

TINY = [
    "sensor.width=8", "sensor.layers=1", "sensor.feedforward=8", "sensor.conv_channels=[4, 4, 4, 4, 4]",
    "train.epochs=2", "train.batch_size=8", "train.max_window=20", "task.attempt_actions=6",
    "task.max_attempts=2", "task.n_holes=2",
]  # fmt: skip


def test_demo_makes_every_stage_and_a_repeat_changes_nothing(tmp_path, capsys):
    out = tmp_path / "demo"
    size = Size(episodes=8, steps=6, attempts=2, assemblies=2)
    demo(config.load(None, TINY), out, size)
    told = capsys.readouterr().out
    assert "95 % interval" in told
    assert "validation NLL" in told
    page = (out / "index.html").read_text()
    assert page.count("<figure") >= 3
    methods = {trial["method"] for trial in results.read(out / "assembly.json").trials}
    assert methods == {"failure_only", "full", "oracle"}
    stages = ("data/manifest.json", "train/metrics.jsonl", "attempt.json", "assembly.json")
    stamps = [(out / name).stat().st_mtime_ns for name in stages]
    demo(config.load(None, TINY), out, size)
    assert stamps == [(out / name).stat().st_mtime_ns for name in stages]
    assert (out / "index.html").read_text() == page


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_demo_learns(tmp_path):
    """At its real size, data and training alone: the updated belief beats the prior on held-out episodes."""
    out = tmp_path / "demo"
    settings = config.load(resources.folder("configs") / "quick.yaml")
    demo(settings, out, Size(attempts=1, assemblies=1))
    rows = [json.loads(line) for line in (out / "train" / "metrics.jsonl").read_text().splitlines()]
    assert min(row["val_nll"] for row in rows) < rows[0]["prior_nll"] - 0.5
