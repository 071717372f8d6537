"""Sweeps: each cell is the experiment itself, and a sweep that is killed goes on to the same result."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from mjx_fit.cli import main
from mjx_fit.config.schema import Config
from mjx_fit.config.sweep_file import read_sweep
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.evaluation import results
from mjx_fit.evaluation import sweep as sweeps
from mjx_fit.evaluation.attempt import attempt
from mjx_fit.evaluation.request import Request
from mjx_fit.evaluation.sweep import BETWEEN, EngineOf, main_rows, sweep
from mjx_fit.report.figures.sweep import of_sweep

PLAN = {
    "experiment": "attempt",
    "trials": 2,
    "seeds": [3, 4],
    "keys": {"scene.friction": [0.15, 0.6], "control.kp_position": [500.0, 600.0]},
}


@pytest.fixture(scope="module")
def asked(tmp_path_factory):
    path = tmp_path_factory.mktemp("sweep") / "sweep.yaml"
    path.write_text(yaml.safe_dump({"task": {"attempt_actions": 3}, "sweep": PLAN}, sort_keys=False))
    return read_sweep([path])


def run(asked, out):
    engine_of = EngineOf(lambda config: (config, NativeEngine(config, 2)))
    return sweep(asked, Request(asked.base, out, engine_of(asked.base)[1], 0), engine_of)


@pytest.fixture(scope="module")
def whole(asked, tmp_path_factory):
    return run(asked, tmp_path_factory.mktemp("whole") / "sweep.json")


def test_each_cell_is_the_experiment_itself(asked, whole, tmp_path):
    assert len(whole.trials) == 4 * 2 * (3 * 2 + 2)
    for number, seed in ((0, 3), (3, 4)):
        config = asked.configs[number]
        request = Request(config, tmp_path / f"{number}.json", NativeEngine(config, 2), 2, seed)
        own = [t for t in whole.trials if (t["cell"], t["root_seed"]) == (number, seed)]
        assert [{k: v for k, v in t.items() if k not in ("cell", "root_seed")} for t in own] == attempt(
            request
        ).trials


def test_rows_pool_the_seeds_of_a_setting(whole):
    (row,) = [
        row
        for row in whole.summary
        if (row.metric, row.group) == ("peak_force_n", f"friction=0.6, kp_position=500.0{BETWEEN}matched")
    ]
    own = [t["peak_force_n"][0] for t in whole.trials if t["cell"] == 2 and t["matched"]]
    assert row.n == len(own) == 2 * 3 * 2
    assert row.value == pytest.approx(np.mean(own), rel=1e-4)


def test_a_sweep_that_is_killed_twice_comes_to_the_same(asked, whole, tmp_path, monkeypatch):
    trials, left = sweeps._trials, [2, 3]

    def killed(*given):
        if left and left[0] == 0:
            left.pop(0)
            raise KeyboardInterrupt
        if left:
            left[0] -= 1
        return trials(*given)

    monkeypatch.setattr(sweeps, "_trials", killed)
    out = tmp_path / "sweep.json"
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            run(asked, out)
    assert run(asked, out) == whole
    assert [path.name for path in tmp_path.iterdir() if path.suffix != ".lock"] == ["sweep.json"]
    assert results.read(out) == whole


def test_another_sweep_is_refused(asked, tmp_path):
    plan = replace(asked.plan, seeds=[5])
    out = tmp_path / "sweep.json"
    run(replace(asked, plan=replace(plan, keys=[{}]), configs=(asked.base,)), out)
    with pytest.raises(Exception, match="holds another result"):
        run(asked, out)


def test_an_unknown_method_is_refused_before_anything_is_written(tmp_path, capsys):
    plan = {"experiment": "position", "methods": ["nobody"], "keys": {"scene.friction": [0.2]}}
    (tmp_path / "s.yaml").write_text(yaml.safe_dump({"sweep": plan}))
    assert main.main(["sweep", "--config", str(tmp_path / "s.yaml"), "--out", str(tmp_path / "out")]) == 2
    assert "--methods: 'nobody' is invalid" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_figure_has_a_column_for_each_value_of_the_other_keys(whole):
    figure = of_sweep(whole)
    axes = figure.axes
    assert [ax.get_title() for ax in axes[:2]] == ["kp_position=500.0", "kp_position=600.0"]
    assert [[tick.get_text() for tick in ax.get_xticklabels()] for ax in axes[2:]] == [["0.15", "0.6"]] * 2
    assert [ax.get_xlabel() for ax in axes[2:]] == ["friction"] * 2
    assert len(main_rows(whole)) == 2 * 4
    drawn = axes[2].lines[0].get_ydata()
    wanted = [row.value for row in main_rows(whole) if row.metric == "peak_force_n" and "500.0" in row.group]
    np.testing.assert_allclose(np.asarray(drawn, float), wanted)


def test_from_a_command_to_a_file_and_a_figure(tmp_path, capsys):
    plan = PLAN | {"keys": [{"scene.friction": 0.2}], "seeds": 1, "trials": 1}
    (tmp_path / "s.yaml").write_text(yaml.safe_dump({"task": {"attempt_actions": 2}, "sweep": plan}))
    words = ["sweep", "--config", str(tmp_path / "s.yaml"), "--out", str(tmp_path / "out")]
    assert main.main(words) == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {"sweep.json", "sweep.png"}
    assert main.main(["report", str(tmp_path / "out" / "sweep.json"), "--out", str(tmp_path / "page")]) == 0
    assert "Main metrics by setting" in (tmp_path / "page" / "index.html").read_text()
    assert main.main([*words, "--set", "sweep.trials=2"]) == 2
    assert "holds another result" in capsys.readouterr().err
    assert Config().task.attempt_actions != 2
