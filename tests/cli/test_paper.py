"""The paper's command, as small as it gets, and killed in between."""

import inspect
from types import SimpleNamespace

import pytest

from mjx_fit.cli import paper
from mjx_fit.cli.paper import RESULTS, SIZES, Size, run_paper, size_of
from mjx_fit.config.files import read_config
from mjx_fit.evaluation import request, results
from mjx_fit.utils import resources
from mjx_fit.utils.errors import RequestError

TINY = [
    "sensor.width=8", "sensor.layers=1", "sensor.feedforward=8", "sensor.conv_channels=[4, 4, 4, 4, 4]",
    "train.epochs=2", "train.batch_size=8", "train.max_window=20", "train.baseline_share=0.5",
    "task.attempt_actions=6", "task.max_attempts=2", "task.n_holes=2",
    "sensor.noise=peg", "sensor.contact_features=false", "sensor.places=0", "train.mirror=false",
]  # fmt: skip
SIZE = Size("cpu", 12, 3, 12, 15, 2, 2, 2, 2, 2, 3)


class KilledError(Exception):
    """Stands for a kill."""


@pytest.fixture
def asked(monkeypatch):
    """Every stage is written down with what it was asked instead of being done."""
    calls = []

    def instead(place, name):
        signature = inspect.signature(getattr(place, name))

        def stage(*args, **named):
            calls.append((name, SimpleNamespace(**signature.bind(*args, **named).arguments)))

        monkeypatch.setattr(place, name, stage)

    for name in (
        "collect",
        "train_from",
        "calibrate",
        "attempt",
        "position",
        "insertion",
        "assembly",
        "build",
    ):
        instead(paper, name)
    trained = SimpleNamespace(network=None, config=None, fingerprint="the sensor's")
    for place in (paper, request):
        monkeypatch.setattr(place, "load_trained_sensor", lambda run: trained)
    monkeypatch.setattr(request, "load_baseline", lambda run: "its baseline")
    monkeypatch.setattr(paper, "filter_update", lambda config, sensor: "its update")
    monkeypatch.setattr(paper, "_actions_per_s", lambda config, engine: 1000.0)
    return calls


def test_what_each_stage_is_asked(tmp_path, asked):
    out = tmp_path / "paper"
    run_paper(read_config(None, TINY), out, SIZE, 10)
    names = ["collect", "collect", "train_from", "calibrate", "collect", "calibrate"]
    names += [name.split("_")[0] for name in RESULTS[2:]]
    assert [name for name, _ in asked] == [*names, "build"]
    stages = [stage for _, stage in asked]
    train, test, own = (stage for name, stage in asked if name == "collect")
    assert len({stage.plan.seed for stage in (train, test, own)}) == 3  # or there would be holes it has seen
    assert (own.plan.sequence, own.plan.sensor, own.update) == (5, "the sensor's", "its update")
    assert stages[2].folders == [train.out]
    assert [stage.data for name, stage in asked if name == "calibrate"] == [test.out, own.out]
    measuring = [stage for name, stage in asked if name not in ("collect", "train_from", "build")]
    wanted = [getattr(stage, "request", stage) for stage in measuring]  # calibrate's are loose
    measured = {one.out.stem: one for one in wanted}
    assert list(measured) == list(RESULTS)
    for name, stage in measured.items():
        assert stage.config.detector.kind == ("disc" if name.endswith("_disc") else "square")
        by_covariance = name in ("assembly_covariance", "assembly_full")
        assert stage.config.task.outcome_model == ("covariance" if by_covariance else "constant")
        assert stage.seed == (12 if name == "calibration_by_attempt" else 10)
    assert {one.engine for one in measured.values() if hasattr(one, "engine")} == {train.engine}
    for name, baseline in (("position", True), ("insertion", True), ("assembly", False)):
        sensors = measured[name].sensor.fingerprint, measured[name].baseline
        assert sensors == ("the sensor's", "its baseline" if baseline else None)
    assert measured["assembly_full"].methods == "full"
    assert measured["assembly_full"].trials == SIZE.many
    assert measured["assembly"].methods == measured["assembly_covariance"].methods
    assert stages[-1].inputs[-1] == stages[2].run.out == out / "run"


@pytest.mark.slow
def test_every_stage_is_done_once_and_a_kill_goes_on(tmp_path, monkeypatch, capsys):
    settings = read_config(None, TINY)
    out = tmp_path / "paper"

    def killed(*args):
        raise KilledError

    with monkeypatch.context() as patch:
        patch.setattr("mjx_fit.cli.paper.insertion", killed)
        with pytest.raises(KilledError):
            run_paper(settings, out, SIZE, 0)
    assert not (out / "insertion.json").exists()
    done = {path: path.stat().st_mtime_ns for path in [*out.glob("*.json"), *(out / "data").iterdir()]}
    assert len(done) > 5
    run_paper(settings, out, SIZE, 0)
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
        assert read_config(resources.folder("configs") / f"{size.preset}.yaml").train.baseline_share > 0
        for count in (size.episodes / size.sequence, size.own / 5):
            assert count == int(count)
    with pytest.raises(RequestError, match="expected above 0"):
        run_paper(read_config(None, [*TINY, "train.baseline_share=0"]), tmp_path / "p", SIZE, 0)
    (tmp_path / "mine.json").write_text("{}")
    with pytest.raises(RequestError, match="it holds other files"):
        run_paper(read_config(None, TINY), tmp_path, SIZE, 0)
    with pytest.raises(RequestError, match="--size: 'huge' is invalid: choose from quick, cpu, full"):
        size_of("huge")
