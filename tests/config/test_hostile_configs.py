"""A thousand configurations: each is refused in one line or runs, and none costs time or memory."""

import argparse
import contextlib
import json
import math
import resource
import time
from pathlib import Path

import hostile
import jax
import numpy as np
import pytest
from fakes import FakeEngine
from places import TESTS

from mjx_fit.cli import main
from mjx_fit.cli.parser import parser
from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config, config_to_tree, config_to_yaml
from mjx_fit.data.collect import collect
from mjx_fit.data.plan import Plan
from mjx_fit.data.schedule import draw_attempts
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.utils import resources
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.randomness import root_key

COUNT = 1000
CPU_S, GIB, LINE = 2.0, 2**30, 600
TILT_DEG = 15.0
ACCEPTED = [tuple(sets) for sets in json.loads((TESTS / "accepted_configs.json").read_text())]
"""Fifty of the thousand."""


@contextlib.contextmanager
def at_most_a_gibibyte_more():
    """No more memory than that above what the process has, or a MemoryError."""
    statm = Path("/proc/self/statm")
    if not statm.exists():  # another system
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    now = int(statm.read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + GIB, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory) -> list[Config | str]:
    """Of each of the thousand, what came of it: a configuration or the refusal."""
    folder, found = tmp_path_factory.mktemp("hostile"), []
    with at_most_a_gibibyte_more():
        for request in hostile.requests(COUNT):
            paths, sets = hostile.write(request, folder)
            began = time.process_time()
            try:
                found.append(read_config(paths, sets))
            except RequestError as error:
                found.append(str(error))
            assert time.process_time() - began < CPU_S, request
    return found


def test_a_thousand_configurations_are_taken_or_refused_in_one_line(outcomes):
    taken = {config_to_yaml(one) for one in outcomes if isinstance(one, Config)}
    refused = [one for one in outcomes if isinstance(one, str)]
    assert len(taken) >= 100
    assert len(refused) >= 300
    for line in refused:
        assert line.isprintable(), line
        assert len(line) < LINE, line
        assert line.startswith(("config: ", "--set: ")), line
        assert "Error" not in line, line


def test_the_command_line_turns_them_into_one_line(tmp_path, monkeypatch, capsys):
    done = []
    monkeypatch.setattr("mjx_fit.data.collect.collect", lambda *args: done.append(args))
    codes = []
    for request in list(hostile.requests(COUNT))[:150]:
        paths, sets = hostile.write(request, tmp_path)
        given = [text for path in paths for text in ("--config", str(path))]
        given += [text for one in sets for text in ("--set", one)]
        codes.append(main.main(["collect", "--out", str(tmp_path / "d"), *given]))
        err = capsys.readouterr().err
        assert (codes[-1], err.count("\n")) in {(0, 0), (2, 1)}, (request, err)
    assert len(done) == codes.count(0) > 20
    assert codes.count(2) > 50
    assert not (tmp_path / "d").exists()


def test_the_fifty_are_of_the_thousand(outcomes):
    assert fifty_of(outcomes) == ACCEPTED


def fifty_of(outcomes: list[Config | str]) -> list[tuple[str, ...]]:
    """What ``accepted_configs.json`` holds: those that change most of what is simulated, as --set strings."""
    home = config_to_tree(Config())
    found = []
    for one in outcomes:
        if isinstance(one, Config):
            tree = config_to_tree(one)
            found.append(
                tuple(
                    f"{section}.{key}={json.dumps(value)}"
                    for section in ("scene", "control", "spiral", "random", "detector", "task")
                    for key, value in tree[section].items()
                    if value != home[section][key]
                )
            )
    return sorted(dict.fromkeys(found), key=len, reverse=True)[:50]


@pytest.mark.parametrize("sets", ACCEPTED[:4], ids=str)
def test_an_accepted_configuration_runs(sets):
    assert_it_runs(sets)


@pytest.mark.slow
@pytest.mark.parametrize("sets", ACCEPTED, ids=str)
def test_fifty_accepted_configurations_run(sets):
    assert_it_runs(sets)


def assert_it_runs(sets: tuple[str, ...]) -> None:
    """One attempt of each policy, two actions each: valid, finite, upright."""
    asked = read_config(None, sets)
    attempts = draw_attempts(root_key(0, "hostile"), np.array([0, 3]), "mixed", asked)
    done = NativeEngine(asked, threads=1).run(attempts, 2, horizon=max(2, asked.task.attempt_actions))
    assert done.truth.valid.all()
    for leaf in (
        *jax.tree.leaves(done.felt.trace),
        done.truth.end_qpos,
        done.truth.end_qvel,
        done.felt.tare_sensor,
    ):
        assert np.isfinite(leaf).all()
    upright = (
        2 * (done.felt.trace.tip_quat_world[..., 1] ** 2 + done.felt.trace.tip_quat_world[..., 2] ** 2) - 1
    )
    ran = np.arange(2) < done.felt.length[:, None]
    assert np.degrees(np.arccos(np.clip(upright, -1, 1)))[ran].max() < TILT_DEG


NUMBERS = list(hostile.numbers())


@pytest.mark.parametrize(("section", "key", "kind", "low", "high"), NUMBERS, ids=str)
def test_every_number_has_both_ends(section, key, kind, low, high):
    assert math.isfinite(low)
    assert math.isfinite(high)
    schema = type(getattr(Config(), section))
    for end in (low, high):
        assert getattr(schema(**_beside(section, key, end)), key) == end
    beyond = [repr(kind(value)) for value in (low - 1, high + 1, 2 * high + 1)]
    for text in (*beyond, "1e308", "-1e308", ".nan", ".inf", "-.inf", "1" + "0" * 99, "1" + "0" * 400):
        with pytest.raises(RequestError, match=rf"{section}\.{key}.*is invalid") as error:
            read_config(None, [f"{section}.{key}={text}"])
        assert len(str(error.value)) < 400
        if len(text) < 100:
            assert f" {low} to {high}" in str(error.value)


def _beside(section: str, key: str, end: float) -> dict:
    return {
        "min_std_m": {"max_std_m": 0.02},
        "max_std_m": {"min_std_m": 0.0001},
        "contact_impedance": {"deep_impedance": 0.99},
        "deep_impedance": {"contact_impedance": 0.1},
    }.get(key, {}) | {key: end}


def test_ranges_hold_what_is_planned():
    """The worlds of DESIGN's section 9."""
    for kp in (350, 360, 375, 565 * math.exp(-0.41), 565 * math.exp(0.41), 840, 1000, 1400):
        read_config(None, [f"control.kp_position={kp}", f"control.kp_orientation={kp}"])
    for friction in (0.15, 0.25, 0.6, 0.8, 1.25):
        for contact_time in (0.004, 0.01, 0.02):
            read_config(None, [f"scene.friction={friction}", f"scene.contact_time_s={contact_time}"])
    read_config(None, ["wrist.force_noise_n=1", "spiral.push_m=0.008", "spiral.wiggle_m=0.0025"])


@pytest.mark.parametrize(
    ("sets", "field"),
    [
        (["spiral.push_m=0.1"], "spiral.push_m"),
        (["spiral.push_m=0.02"], "spiral.push_m"),
        (["random.push_m=0.012", "control.kp_position=1000"], "random.push_m"),
        (["spiral.radius_m=0.03", "control.kp_position=1400"], "spiral.radius_m"),
        (["scene.friction=1.25", "control.kp_position=1400"], "spiral.radius_m"),
        (["task.attempt_actions=2", "control.kp_position=1400"], "spiral.radius_m"),
        (["control.push=force", "control.press_n=9"], "control.press_n"),
        (["control.push=force", "control.press_speed_mps=0.002"], "control.press_n"),
        (["spiral.wiggle_m=0.05"], "spiral.wiggle_m"),
        (["spiral.wiggle_m=0.005"], "spiral.wiggle_m"),
        (["random.wiggle_m=0.005"], "random.wiggle_m"),
        (["control.kp_position=1e5"], "control.kp_position"),
        (["control.damping_ratio=4.9", "control.kp_orientation=4000"], "control.damping_ratio"),
        (["scene.contact_time_s=0.05", "scene.friction=1.5"], "scene.contact_time_s"),
    ],
)
def test_what_tilts_a_peg_or_lifts_it_is_refused(sets, field):
    with pytest.raises(RequestError, match=rf"^config: {field}: .* is (invalid|out of range): expected"):
        read_config(None, sets)


@pytest.mark.parametrize(
    "sets",
    [
        ["random.reach_m=0.051", "scene.plate_half_width_m=0.2"],
        ["random.actions_per_sweep=1", "control.kp_position=1124"],
        ["scene.friction=1.25", "control.kp_position=851"],
    ],
)
def test_sweeps_that_tilt_a_peg_are_refused_where_they_are_used(sets, tmp_path):
    asked = read_config(None, sets)
    with pytest.raises(
        RequestError, match=r"^config: random\.reach_m: .* is (invalid|out of range): expected"
    ):
        collect(asked, tmp_path / "d", Plan(episodes=2, actions=1, policy="random"), FakeEngine())
    assert not (tmp_path / "d").exists()


@pytest.mark.parametrize(
    "argv",
    [
        ["train", "--data", "d", "--out", "r", "--members", "1000000"],
        ["train", "--data", "d", "--out", "r", "--epochs", "1000000000"],
        ["train", "--data", "d", "--out", "r", "--set", "train.batch_size=1000000000"],
        ["evaluate", "assembly", "--out", "r.json", "--methods", "oracle", "--trials", str(10**12)],
        ["evaluate", "assembly", "--out", "r.json", "--set", f"task.max_attempts={10**18}"],
        ["evaluate", "insertion", "--out", "r.json", "--seeds", "100000000"],
        ["evaluate", "insertion", "--out", "r.json", "--trials", "1000000", "--seeds", "10000"],
        ["evaluate", "position", "--out", "r.json", "--trials", "0"],
        ["evaluate", "attempt", "--out", "r.json", "--trials", str(10**7)],
        ["render", "--out", "r.mp4", "--trial", str(10**30)],
        ["collect", "--out", "d", "--set", f"wrist.tare_samples={10**400}"],
        ["collect", "--out", "d", "--episodes", str(10**7 + 1)],
        ["collect", "--out", "d", "--num-shards", str(10**30)],
    ],
    ids=lambda argv: " ".join(argv)[:70],
)
def test_counts_without_end_are_refused_at_once(argv, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main.main(argv) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "expected" in err or "digits" in err
    assert not list(tmp_path.iterdir())


def _whole_number_options() -> list[tuple[tuple[str, ...], str]]:
    """Every option of every command that takes a whole number."""
    found, waiting = [], [((), parser())]
    while waiting:
        name, command = waiting.pop()
        for action in command._actions:
            if isinstance(action, argparse._SubParsersAction):
                waiting += [((*name, word), sub) for word, sub in action.choices.items()]
            elif action.type is int and action.help != argparse.SUPPRESS:
                found.append((name, action.option_strings[0]))
    return sorted(found)


NEEDED = {
    ("collect",): ["--out", "d"],
    ("train",): ["--data", "d", "--out", "r"],
    ("paper",): ["--out", "p"],
    ("render",): ["--out", "r.mp4"],
    ("sweep",): ["--out", "s"],
    ("evaluate", "calibration"): ["--data", "d", "--out", "r.json"],
}


@pytest.mark.parametrize(("name", "option"), _whole_number_options(), ids=str)
def test_whole_numbers_without_end_are_refused_everywhere(name, option, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    needed = NEEDED.get(name, ["--out", "r.json"] if name[0] == "evaluate" else [])
    for text in (str(10**30), "9" * 5000, "-" + "9" * 30, "1e3", "٣" * 40):
        assert main.main([*name, *needed, f"{option}={text}"]) == 2
        err = capsys.readouterr().err
        assert err.count("\n") == 1
        assert len(err) < LINE
        assert option in err
    assert not list(tmp_path.iterdir())


def test_every_shipped_configuration_is_accepted():
    for folder in ("configs", "weights"):
        for path in resources.folder(folder).rglob("*.yaml"):
            read_config(path)
