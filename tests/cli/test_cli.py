"""The command line as scripts see it: exit codes, one line on stderr, nothing half written."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from importlib.metadata import version

import pytest
import yaml
from synthetic import PAPER_SENSOR

from mjx_fit.cli import main
from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config, config_to_yaml
from mjx_fit.data.manifest import read_manifest, write_manifest
from mjx_fit.evaluation import results
from mjx_fit.training import checkpoint
from mjx_fit.utils import interrupts, resources

TINY = ["--set", "task.attempt_actions=2", "--set", "task.max_attempts=2", "--set", "task.n_holes=2"]


@pytest.fixture
def refused(capsys):
    """Runs a command that must be refused: exit code 2, one line on stderr, nothing on stdout."""

    def run(*argv):
        code = main.main([str(arg) for arg in argv])
        out, err = capsys.readouterr()
        assert code == 2, err
        assert out == ""
        assert err.count("\n") == 1
        assert "Traceback" not in err
        return err

    return run


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    out = tmp_path_factory.mktemp("cli") / "data"
    assert (
        main.main(["collect", "--out", str(out), "--episodes", "4", "--steps", "6", "--engine", "native"])
        == 0
    )
    return out


def test_unknown_config_key(refused, tmp_path):
    err = refused("collect", "--out", tmp_path / "d", "--set", "scene.clearence_m=0.001")
    assert "scene.clearence_m" in err
    assert "clearance_m" in err
    (tmp_path / "c.yaml").write_text("sceen: {clearance_m: 0.001}")
    assert "sceen" in refused(
        "evaluate", "attempt", "--out", tmp_path / "f.json", "--config", tmp_path / "c.yaml"
    )
    assert [path.name for path in tmp_path.iterdir()] == ["c.yaml"]


def test_config_of_wrong_type_or_range(refused, tmp_path):
    out = ["collect", "--out", tmp_path / "d"]
    assert "'wide'" in refused(*out, "--set", "scene.clearance_m=wide")
    assert "expected a number from 0.0001 to 0.005" in refused(*out, "--set", "scene.clearance_m=1")
    assert "'blob'" in refused(*out, "--set", "detector.kind=blob")
    assert "True" in refused(*out, "--set", "scene.friction=true")
    assert "section.key=value" in refused(*out, "--set", "clearance")
    assert "expected a YAML value" in refused(*out, "--set", "scene.friction=[")
    assert "2020-01-01" in refused(*out, "--set", "scene.friction=2020-01-01")
    assert "cannot be read" in refused(*out, "--config", tmp_path / "missing.yaml")


def test_negative_episodes(refused, tmp_path):
    err = refused("collect", "--out", tmp_path / "d", "--episodes", "-1")
    assert "--episodes: -1 is out of range: expected 1 to" in err
    assert not (tmp_path / "d").exists()


def test_bad_seeds_and_places(refused, data, tmp_path):
    (tmp_path / "file").write_text("")
    assert "--seed: -1 is out of range" in refused(
        "train", "--data", data, "--out", tmp_path / "r", "--seed", -1
    )
    assert "--seed: -1 is out of range" in refused(
        "evaluate", "attempt", "--out", tmp_path / "r", "--seed", -1
    )
    assert "it is a file, expected a folder" in refused(
        "collect", "--out", tmp_path / "file" / "sub", "--episodes", 1
    )
    for command in (["evaluate", "attempt"], ["evaluate", "assembly", "--methods", "oracle"]):
        assert "cannot be used" in refused(*command, "--out", "/proc/nowhere/x.json")
    crowded = ["--set", "scene.plate_half_width_m=0.2", "--methods", "oracle"]
    assert "task.n_holes" in refused("evaluate", "assembly", "--out", tmp_path / "r.json", *crowded)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_impossible_network_leaves_the_folder_free(refused, data, tmp_path):
    command = ["train", "--data", data, "--out", tmp_path / "run", "--epochs", 1]
    assert "sensor.heads" in refused(*command, "--set", "sensor.heads=3")
    assert not (tmp_path / "run").exists()


def test_a_users_file_is_not_overwritten(refused, data, tmp_path):
    (tmp_path / "config.yaml").write_text("mine: yes")
    assert "holds other files" in refused("train", "--data", data, "--out", tmp_path, "--epochs", 1)
    assert (tmp_path / "config.yaml").read_text() == "mine: yes"


def test_the_version_is_the_packages(capsys):
    with pytest.raises(SystemExit, match="0"):
        main.main(["--version"])
    assert capsys.readouterr().out == f"mjx-fit {version('mjx-fit')}\n"


def test_unknown_engine(refused, tmp_path):
    for command in (["collect"], ["evaluate", "attempt"], ["evaluate", "assembly", "--methods", "oracle"]):
        err = refused(*command, "--out", tmp_path / "x.json", "--engine", "warp9")
        assert "'warp9' is invalid: choose from auto, mjx, native" in err
    assert not list(tmp_path.iterdir())


def test_a_result_has_a_name_by_which_a_report_finds_it(refused, tmp_path):
    err = refused("evaluate", "attempt", "--out", tmp_path / "x.txt", "--engine", "native")
    assert "x.txt is invalid: it must end in .json" in err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("inside", "argv", "goes_on"),
    [
        ("mjx_fit.data.collect.collect", ["collect", "--out", "d"], True),
        ("mjx_fit.evaluation.assembly.assembly", ["evaluate", "assembly", "--out", "a.json"], True),
        ("mjx_fit.evaluation.attempt.attempt", ["evaluate", "attempt", "--out", "a.json"], True),
        ("mjx_fit.report.build.build", ["report", "d", "--out", "page"], False),
    ],
)
def test_an_interrupt_says_whether_anything_was_kept(inside, argv, goes_on, monkeypatch, capsys):
    def interrupted(*args):
        raise KeyboardInterrupt

    def ends(code):
        raise SystemExit(code)

    monkeypatch.setattr(inside, interrupted)
    monkeypatch.setattr(interrupts.os, "_exit", ends)
    with pytest.raises(SystemExit, match="130"):
        main.main(argv)
    end = "; run the same command again to resume" if goes_on else ""
    assert capsys.readouterr().err == f"mjx-fit: stopped{end}\n"


@pytest.mark.parametrize(
    ("inside", "argv", "preset"),
    [
        ("mjx_fit.cli.demo.run_demo", ["demo"], "demo"),
        ("mjx_fit.cli.demo.run_demo", ["demo", "--train"], "quick"),
        ("mjx_fit.cli.paper.run_paper", ["paper", "--size", "cpu"], "cpu"),
    ],
)
def test_a_file_of_ones_own_comes_on_top_of_a_preset(inside, argv, preset, monkeypatch, tmp_path):
    asked = []
    monkeypatch.setattr(inside, lambda config, *rest: asked.append(config))
    mine = tmp_path / "mine.yaml"
    mine.write_text("scene: {friction: 0.4}\n")
    assert main.main([*argv, "--out", str(tmp_path / "out"), "--config", str(mine)]) == 0
    by_itself = read_config(resources.folder("configs") / f"{preset}.yaml")
    assert asked == [replace(by_itself, scene=replace(by_itself.scene, friction=0.4))]


def test_options_are_written_out(refused, tmp_path):
    """--trial is another option elsewhere: an assembly is not to be taken for two of them."""
    err = refused("evaluate", "assembly", "--trial", 2, "--out", tmp_path / "x.json")
    assert "unrecognized arguments: --trial 2" in err


def test_missing_data_folder(refused, tmp_path):
    missing = tmp_path / "nowhere"
    assert f"{missing} cannot be used" in refused("train", "--data", missing, "--out", tmp_path / "run")
    assert "no such folder" in refused("data", "info", missing, "--json")
    assert not list(tmp_path.iterdir())


def test_run_without_a_checkpoint(refused, tmp_path):
    run, out = tmp_path / "run", tmp_path / "f.json"
    command = ["evaluate", "assembly", "--methods", "full", "--out", out]
    assert "no such folder" in refused(*command, "--run", run)
    run.mkdir()
    assert "not a training run" in refused(*command, "--run", run)
    (run / "config.yaml").write_text(config_to_yaml(Config()))
    assert "no checkpoint" in refused(*command, "--run", run)
    assert not out.exists()


def test_folder_that_holds_another_run(refused, data):
    before = {path.name: path.read_bytes() for path in data.iterdir()}
    err = refused("collect", "--out", data, "--episodes", 4, "--steps", 6, "--engine", "native", "--seed", 9)
    assert "holds another run" in err
    assert before == {path.name: path.read_bytes() for path in data.iterdir()}


def test_words_that_are_no_command(refused):
    assert "invalid choice: 'colect'" in refused("colect")
    assert "--out" in refused("collect")
    assert "invalid int value: 'many'" in refused("collect", "--out", "d", "--episodes", "many")
    assert "invalid choice" in refused("evaluate", "dance")


def test_report_of_what_is_not_there(refused, tmp_path):
    assert "does not exist" in refused("report", tmp_path / "f.json", "--out", tmp_path / "page")
    assert not list(tmp_path.iterdir())


def test_report_and_demo_leave_foreign_folders_alone(refused, data, tmp_path):
    (tmp_path / "thesis.txt").write_text("precious")
    assert "holds other files (thesis.txt)" in refused("report", data, "--out", tmp_path)
    assert "holds other files (thesis.txt)" in refused("demo", "--out", tmp_path)
    (tmp_path / "index.html").write_text("<html>mine</html>")
    assert "its index.html is not a report" in refused("report", data, "--out", tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["index.html", "thesis.txt"]


def test_a_data_set_gets_its_card_beside_it(data, tmp_path, capsys):
    folder = shutil.copytree(data, tmp_path / "data")
    assert main.main(["report", str(folder)]) == 0
    page = folder / "report" / "index.html"
    assert capsys.readouterr().out.strip() == str(page)
    assert "6 actions" in page.read_text()
    assert main.main(["data", "check", str(folder)]) == 0  # it is still a data set, and still the same
    argv = ["collect", "--out", str(folder), "--episodes", "4", "--steps", "6", "--engine", "native"]
    assert main.main(argv) == 0


def test_data_check_names_what_is_damaged(data, tmp_path, capsys):
    folder = shutil.copytree(data, tmp_path / "data")
    assert main.main(["data", "check", str(folder)]) == 0
    assert "complete, all 1 shards whole" in capsys.readouterr().out
    (folder / "shard-00000000.h5").write_bytes(b"gone")
    assert main.main(["data", "check", str(folder)]) == 1
    out, err = capsys.readouterr()
    assert out.splitlines() == [out.strip()]
    assert out.startswith("shard-00000000.h5: damaged: 4 bytes")
    assert err.count("\n") == 1


def test_data_check_says_how_to_go_on(data, tmp_path, capsys):
    folder = shutil.copytree(data, tmp_path / "data")
    write_manifest(folder, replace(read_manifest(folder), complete=False))
    assert main.main(["data", "check", str(folder)]) == 0
    said, command = capsys.readouterr().out.splitlines()
    assert "not complete: 1 of 1 shards, all whole" in said
    assert main.main(command.partition(" and its")[0].split()[1:]) == 0
    assert read_manifest(folder).complete


def test_parts_are_collected_merged_and_exported(tmp_path, capsys, refused):
    common = ["--episodes", "4", "--steps", "3", "--batch", "2", "--engine", "native", "--num-shards", "2"]
    parts = [str(tmp_path / f"part{i}") for i in range(2)]
    for i, part in enumerate(parts):
        assert main.main(["collect", "--out", part, *common, "--shard-index", str(i)]) == 0
    assert "part 1 of 2" in capsys.readouterr().out
    whole = str(tmp_path / "whole")
    assert "part 1 of 2 is missing" in refused("data", "merge", parts[0], "--out", whole)
    assert main.main(["data", "merge", *parts, "--out", whole]) == 0
    for name in ("whole.npz", "whole.hdf5"):
        assert main.main(["data", "export", whole, "--out", str(tmp_path / name)]) == 0
        assert (tmp_path / name).stat().st_size > 1000
    capsys.readouterr()
    assert "must end in" in refused("data", "export", whole, "--out", tmp_path / "whole.csv")
    assert "no such folder" in refused("data", "check", tmp_path / "nowhere")


def test_data_info_tells_what_was_asked_for(data, capsys):
    assert main.main(["data", "info", str(data), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert {"episodes", "steps", "pairs", "success_rate", "units", "engine", "seed"} <= set(told)
    assert (told["episodes"], told["steps"], told["engine"], told["seed"]) == (4, 6, "native", 0)


def test_info_tells_versions_devices_and_engine(capsys):
    assert main.main(["info", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["engine"] in ("native", "mjx")
    assert told["versions"]["mujoco"].startswith("3.17")


def test_json_on_stdout_is_nothing_but_json():
    """In a process of its own: libraries print when they are imported."""
    done = subprocess.run(
        [sys.executable, "-m", "mjx_fit", "info", "--json"],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    json.loads(done.stdout)


def test_attempt_from_command_to_file(tmp_path, capsys, refused):
    out = tmp_path / "attempt.json"
    command = ["evaluate", "attempt", "--trials", "2", "--engine", "native", "--out", str(out), *TINY]
    assert main.main(command) == 0
    assert "success rate" in capsys.readouterr().out
    result = results.read(out)
    rates = [row for row in result.summary if row.metric == "success_rate"]
    assert [row.group for row in rates] == ["matched", "mismatched", "cross", "rectangle", "square"]
    assert [row.n for row in rates] == [6, 2, 2, 2, 2]
    assert {"seconds", "peak_force_n", "over_20n_share"} <= {row.metric for row in result.summary}
    assert all(row.low is not None and row.high is not None for row in result.summary)
    assert {"config", "seed", "engine", "device", "versions"} <= set(json.loads(out.read_text()))
    content, stamp = out.read_bytes(), out.stat().st_mtime_ns
    assert main.main(command) == 0
    assert out.stat().st_mtime_ns == stamp
    capsys.readouterr()
    assert "holds another result" in refused(*command, "--seed", "4")
    assert out.read_bytes() == content
    (tmp_path / "again").mkdir()
    assert main.main([*command[: -len(TINY) - 1], str(tmp_path / "again" / "attempt.json"), *TINY]) == 0
    assert (tmp_path / "again" / "attempt.json").read_bytes() == content


@pytest.fixture(scope="module")
def trained(data, tmp_path_factory):
    """A run, as small as it gets, and the settings that it was made with."""
    folder = tmp_path_factory.mktemp("trained")
    small = {"sensor": {"width": 8, "layers": 1, "feedforward": 8, "conv_channels": [4] * 5} | PAPER_SENSOR}
    small |= {"train": {"epochs": 2, "batch_size": 4, "max_window": 6, "min_window": 3, "mirror": False}}
    (folder / "c.yaml").write_text(yaml.safe_dump(small))
    settings = ["--config", str(folder / "c.yaml"), *TINY]
    assert main.main(["train", "--data", str(data), "--out", str(folder / "run"), *settings]) == 0
    return folder / "run", settings


def test_data_to_training_to_assembly_to_report(data, trained, tmp_path, capsys, refused):
    """The whole chain on real physics."""
    (run, settings), out = trained, tmp_path / "assembly.json"
    assert len((run / "metrics.jsonl").read_text().splitlines()) == 2
    methods = ["--methods", "failure_only,full,oracle"]
    command = ["evaluate", "assembly", *methods, "--trials", "2", "--run", str(run)]
    assert main.main([*command, "--out", str(out), *settings]) == 0
    result = results.read(out)
    assert {trial["method"] for trial in result.trials} == {"failure_only", "full", "oracle"}
    assert result.config["sensor"]["width"] == 8
    assert result.request["differs_from_training"] == []
    assert all(len(trial["attempts"]) == 2 and max(trial["attempts"]) <= 2 for trial in result.trials)
    own = str(tmp_path / "w.json")
    without = ["evaluate", "assembly", "--methods", "full", "--trials", "1", "--out", own]
    assert main.main([*without, *TINY]) == 0
    sensor, _ = checkpoint.load_sensor(resources.folder("weights"))
    assert results.read(tmp_path / "w.json").request["sensor"] == checkpoint.fingerprint_of(sensor)
    capsys.readouterr()
    other = ["--out", tmp_path / "other.json", *settings[2:], "--set", "sensor.width=16"]
    assert "sensor.width is 8 there and 16 here" in refused(*command, *other)
    assert main.main(["report", str(out), str(run), str(data), "--out", str(tmp_path / "page")]) == 0
    page = (tmp_path / "page" / "index.html").read_text()
    assert page.count("<svg") >= 3
    capsys.readouterr()


@pytest.mark.slow  # test_collect has it without the command line
def test_sequences_start_from_what_the_runs_sensor_believes(trained, tmp_path, capsys):
    (run, settings), out = trained, tmp_path / "own"
    command = ["collect", "--out", str(out), "--episodes", "8", "--sequence", "2", "--steps", "6", "--run"]
    options = ["--policy", "spiral", "--engine", "native", "--set", "task.attempt_actions=6"]
    assert main.main([*command, str(run), *options]) == 0
    asked = read_manifest(out).request
    assert asked["sensor"] == checkpoint.fingerprint_of(checkpoint.load_sensor(run)[0])
    assert main.main([*command, str(run), *options]) == 0
    capsys.readouterr()
    assert main.main([*command, str(resources.folder("weights")), *options]) == 2
    assert "sensor" in capsys.readouterr().err
    alone = ["--set", "train.baseline_share=0"]
    drawn = ["train", "--data", str(out), "--out", str(tmp_path / "chained"), *settings]
    assert main.main([*drawn, "--set", "train.sequence=2", "--set", "train.min_window=6", *alone]) == 0


@pytest.mark.slow
def test_calibration_on_attempts_of_its_own(data, trained, tmp_path, refused):
    """With the run's baseline beside it; the data that it was trained on are refused."""
    (run, settings), fresh, out = trained, tmp_path / "fresh", tmp_path / "calibration.json"
    seen = ["evaluate", "calibration", "--run", run, "--out", tmp_path / "seen.json", *settings]
    assert "trained on cannot be used" in refused(*seen, "--data", data)
    assert not (tmp_path / "seen.json").exists()
    collect = ["collect", "--out", str(fresh), "--episodes", "18", "--steps", "2", "--policy", "spiral"]
    assert main.main([*collect, "--seed", "1", "--engine", "native", *TINY]) == 0
    command = ["evaluate", "calibration", "--run", str(run), "--data", str(fresh), "--out", str(out)]
    assert main.main([*command, *settings]) == 0
    result = results.read(out)
    assert {trial["method"] for trial in result.trials} == {"full", "frame_by_frame"}
    assert {trial["actions"] for trial in result.trials} == {2}
    rows = {(row.method, row.metric, row.group): row for row in result.summary}
    assert (
        rows["full", "position_error_cm", "all"].n == rows["full", "position_error_cm", "actions:1"].n == 18
    )
    whole = [t for t in result.trials if t["method"] == "full"]
    mean = sum(trial["error_cm"] for trial in whole) / 18
    assert rows["full", "position_error_cm", "all"].value == pytest.approx(mean, rel=1e-4)
    auroc = rows["full", "match_auroc", "all"]
    assert auroc.low is not None
    assert auroc.low <= auroc.value
    assert ("frame_by_frame", "match_auroc", "all") not in rows
    content = out.read_bytes()
    assert main.main([*command, *settings]) == 0
    assert out.read_bytes() == content
    shard = next(fresh.glob("*.h5"))
    shard.write_bytes(shard.read_bytes()[:-100])
    command[-1] = str(tmp_path / "damaged.json")
    assert main.main([*command, *settings]) == 2
    assert not (tmp_path / "damaged.json").exists()
