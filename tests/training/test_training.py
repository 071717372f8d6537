"""Training on a small set whose wrench tells the answer: it learns, resumes, and refuses what it must."""

import errno
import json
import math
import os
import shutil
import time
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from faults import Faults
from flax import nnx
from synthetic import PAPER_SENSOR, PAPER_TRAINING, make_episodes, with_felt, with_trace, with_truth

from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config, config_to_tree
from mjx_fit.config.sections.learning import SensorConfig, TrainConfig
from mjx_fit.data.batches import placed
from mjx_fit.data.windows import sample_windows
from mjx_fit.training import run_files, run_folder
from mjx_fit.training.checkpoint import LAST, from_arrays, load_sensor, to_arrays
from mjx_fit.training.loop import train
from mjx_fit.training.loss import filter_loss
from mjx_fit.training.run import Lineage, Run
from mjx_fit.training.saver import Saver
from mjx_fit.training.split import require_chains
from mjx_fit.training.step import TrainState, optimizer
from mjx_fit.training.train import FRAME_BY_FRAME, train_with_baseline
from mjx_fit.utils.errors import RequestError, WorkError

EPISODES, EPOCHS = 240, 40
DATA = make_episodes(EPISODES, actions=12, min_length=6)


def changed(**fields):
    """The data with other fields of what was felt, or of the truth."""
    parts = DATA.rollout.felt, DATA.rollout.truth
    felt, truth = ({k: v for k, v in fields.items() if hasattr(one, k)} for one in parts)
    return replace(DATA, rollout=with_truth(with_felt(DATA.rollout, **felt), **truth))


CONFIG = Config(
    sensor=SensorConfig(
        width=16,
        conv_channels=(4, 4, 8, 8, 8),
        layers=1,
        heads=2,
        feedforward=16,
        dropout=0.1,
        positional=True,
        **PAPER_SENSOR,
    ),
    train=TrainConfig(
        epochs=EPOCHS,
        batch_size=32,
        learning_rate=5e-3,
        min_window=4,
        max_window=8,
        validation_fraction=0.25,
        **PAPER_TRAINING,
    ),
)


class KilledError(Exception):
    """Stands for a kill."""


def metrics(out: Path) -> list[dict]:
    rows = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
    assert all(row.pop("seconds") >= 0 for row in rows)
    return rows


def files(out: Path) -> dict:
    return {path.relative_to(out): path.read_bytes() for path in sorted(out.rglob("*")) if path.is_file()}


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("training") / "run"
    train(DATA, CONFIG, Run(out, 0))
    return out


def test_it_learns_more_than_the_prior_knows(run):
    rows = metrics(run)
    assert [row["epoch"] for row in rows] == list(range(EPOCHS))
    assert rows[-1]["val_nll"] < rows[-1]["prior_nll"] - 0.5
    assert rows[-1]["total"] < rows[0]["total"]
    assert len({row["prior_nll"] for row in rows}) == 1
    for row in rows:
        five = ("pos_logdet", "pos_mahalanobis", "type_nll", "match_nll", "mismatch_nll")
        for prefix in ("", "val_"):
            assert row[prefix + "total"] == pytest.approx(sum(row[prefix + name] for name in five), abs=1e-4)
            first_three = sum(row[prefix + name] for name in five[:3])
            assert row[prefix + "nll"] == pytest.approx(first_three, abs=1e-4)


def test_the_folder_says_what_the_run_is(run):
    assert read_config(run / "config.yaml") == CONFIG
    told = json.loads((run / "run.json").read_text())
    assert told["seed"] == 0
    assert told["versions"]["jax"] == jax.__version__
    assert told["device"].startswith("cpu")


def test_the_best_sensor_comes_back_with_its_scaling(run):
    sensor, config = load_sensor(run)
    assert config == CONFIG
    sample = sample_windows(DATA, jnp.arange(EPISODES), jax.random.key(3), config)
    losses = nnx.jit(lambda sensor, sample: filter_loss(sensor(sample.reading), sample))(sensor, sample)
    assert float(losses.nll.mean()) < float(losses.prior_nll.mean()) - 0.5
    assert np.abs(sensor.wrench_scale[...][1] - 1).max() > 1


def test_a_finished_run_repeated_changes_nothing(run):
    before = files(run)
    train(DATA, CONFIG, Run(run, 0))
    assert files(run) == before


@pytest.mark.parametrize("kill_after", [2, 7])
def test_a_killed_run_continued_gives_the_same_curve(run, tmp_path, kill_after):
    def kill(row):
        if row["epoch"] == kill_after:
            raise KilledError

    out = tmp_path / "run"
    with pytest.raises(KilledError):
        train(DATA, CONFIG, Run(out, 0), on_epoch=kill, checkpoint_every_s=0.0)
    # A kill may fall between the metrics and the checkpoint, and in the middle of a line.
    with (out / "metrics.jsonl").open("a") as file:
        file.write('{"epoch": 99, "total"')
    seen = []
    train(DATA, CONFIG, Run(out, 0), on_epoch=lambda row: seen.append(row["epoch"]))
    assert seen == list(range(kill_after + 1, EPOCHS))
    assert metrics(out) == metrics(run)
    for (_, one), (_, other) in zip(
        *(nnx.to_flat_state(nnx.state(load_sensor(x)[0])) for x in (out, run)), strict=True
    ):
        np.testing.assert_array_equal(one[...], other[...])


def test_a_run_killed_before_its_first_checkpoint_begins_again(run, tmp_path):
    out = tmp_path / "run"
    shutil.copytree(run, out)
    shutil.rmtree(out / "checkpoints")
    train(DATA, CONFIG, Run(out, 0))
    assert metrics(out) == metrics(run)


def test_more_epochs_continue_the_run(run, tmp_path):
    out = tmp_path / "run"
    shutil.copytree(run, out)
    longer = replace(CONFIG, train=replace(CONFIG.train, epochs=EPOCHS + 2))
    train(DATA, longer, Run(out, 0))
    assert metrics(out)[:EPOCHS] == metrics(run)
    assert len(metrics(out)) == EPOCHS + 2
    assert read_config(out / "config.yaml") == longer


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda out: {"run": Run(out, 1)}, "seed is 0 there and 1 here"),
        (lambda _: {"data": make_episodes(EPISODES, actions=12, min_length=6, seed=1)}, "data is"),
        (
            lambda _: {"config": replace(CONFIG, train=replace(CONFIG.train, batch_size=4))},
            r"train\.batch_size is 32 there and 4 here",
        ),
    ],
)
def test_another_run_in_the_same_folder_is_refused(run, change, message):
    before = files(run)
    with pytest.raises(RequestError, match=message) as caught:
        train(**({"data": DATA, "config": CONFIG, "run": Run(run, 0)} | change(run)))
    assert "\n" not in str(caught.value)
    assert files(run) == before


def test_a_folder_with_other_files_is_refused(tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(RequestError, match=r"thesis\.tex"):
        train(DATA, CONFIG, Run(tmp_path, 0))


def test_too_little_data_and_impossible_windows_are_refused(tmp_path):
    with pytest.raises(RequestError, match="--data"):
        train(jax.tree.map(lambda x: x[:1], DATA), CONFIG, Run(tmp_path / "a", 0))
    with pytest.raises(RequestError, match="at least one of each"):
        train(changed(valid=np.zeros(EPISODES, bool)), CONFIG, Run(tmp_path / "b", 0))
    with pytest.raises(RequestError, match=r"train\.min_window: 9"):
        train(DATA, replace(CONFIG, train=replace(CONFIG.train, min_window=9)), Run(tmp_path / "c", 0))
    assert not list(tmp_path.iterdir())


def test_runs_that_cannot_be_loaded_are_named(run, tmp_path):
    with pytest.raises(RequestError, match="no such folder"):
        load_sensor(tmp_path / "nowhere")
    with pytest.raises(RequestError, match="not a training run"):
        load_sensor(tmp_path)
    out = tmp_path / "run"
    shutil.copytree(run, out)
    other = (run / "config.yaml").read_text().replace("feedforward: 16", "feedforward: 8")
    (out / "config.yaml").write_text(other)
    with pytest.raises(RequestError, match="does not fit the configuration"):
        load_sensor(out)
    shutil.rmtree(out / "checkpoints")
    with pytest.raises(RequestError, match="holds no checkpoint") as caught:
        load_sensor(out)
    assert str(out) in str(caught.value)
    assert not (out / LAST).exists()


def test_a_diverged_training_says_so(tmp_path, monkeypatch):
    adamw = optax.adamw  # more than a configuration may ask for
    monkeypatch.setattr(optax, "adamw", lambda _, **rest: adamw(1e30, **rest))
    wild = replace(CONFIG, train=replace(CONFIG.train, learning_rate=1.0))
    with pytest.raises(WorkError, match=r"epoch \d is not finite"):
        train(DATA, wild, Run(tmp_path / "run", 0))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"hole_pos_world": np.full((EPISODES, 2), np.nan, np.float32)}, "hole_pos_world of episode 0 "),
        ({"peg_type": np.full(EPISODES, 3)}, "peg_type: 3 is invalid: there are 3 types"),
        (
            {"trace": replace(DATA.rollout.felt.trace, wrench_sensor=np.zeros((EPISODES, 12, 25, 6)))},
            r"wrench_sensor: windows of shape \(25, 6\)",
        ),
    ],
)
def test_data_that_no_sensor_can_read_are_refused(tmp_path, change, message):
    with pytest.raises(RequestError, match=message) as caught:
        train(changed(**change), CONFIG, Run(tmp_path / "run", 0))
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "run").exists()


@pytest.mark.slow  # test_training_through_sequences has an unused NaN, too
def test_a_broken_episode_that_is_not_used_does_no_harm(run, tmp_path):
    short = np.asarray(DATA.rollout.felt.length) < 7
    short[40:] = False  # as many batches as without: nothing compiles again
    assert short.sum() > 2
    length = np.where(short, 3, DATA.rollout.felt.length)
    place = np.where(short[:, None], np.nan, DATA.rollout.truth.hole_pos_world)
    train(changed(length=length, hole_pos_world=place), one_epoch(CONFIG), Run(tmp_path / "run", 0))
    assert metrics(tmp_path / "run")[0]["val_nll"] < 100


def one_epoch(config: Config) -> Config:
    return replace(config, train=replace(config.train, epochs=1))


def test_data_too_large_for_the_device_give_the_same_curve(run, tmp_path, monkeypatch):
    monkeypatch.setattr("mjx_fit.training.loop.placed", lambda data: placed(data, free_bytes=0))
    few = replace(CONFIG, train=replace(CONFIG.train, epochs=3))
    train(DATA, few, Run(tmp_path / "run", 0))
    for here, there in zip(metrics(tmp_path / "run"), metrics(run), strict=False):
        assert here == pytest.approx(there, rel=1e-4, abs=1e-5)


def test_training_stops_early_and_stays_stopped(run, tmp_path):
    """Where the curve of a run without patience has not improved for an epoch."""
    still = replace(CONFIG, train=replace(CONFIG.train, patience=1))
    out = tmp_path / "run"
    train(DATA, still, Run(out, 0))
    whole = metrics(run)
    nll = [row["val_nll"] for row in whole]
    end = next(epoch for epoch in range(1, EPOCHS) if nll[epoch] >= min(nll[:epoch])) + 1
    assert metrics(out) == whole[:end]
    assert end < EPOCHS
    before = files(out)
    train(DATA, still, Run(out, 0))
    assert files(out) == before


def test_a_cosine_schedule_ends_with_its_epochs(tmp_path):
    out = tmp_path / "run"
    waved = replace(CONFIG, train=replace(CONFIG.train, schedule="cosine", epochs=2))
    lineage, sides = Lineage(0, "data"), (np.arange(180), np.arange(180, 240))
    run_folder.write(out, waved, lineage, [{}], np.arange(EPISODES), sides)
    run_folder.check(out, waved, lineage)
    with pytest.raises(RequestError, match=r"train\.epochs is 2 there and 3 here"):
        run_folder.check(out, replace(waved, train=replace(waved.train, epochs=3)), lineage)
    rate = optimizer(waved, 10)
    params = {"w": jnp.ones(())}
    state = rate.init(params)
    steps = []
    for _ in range(20):
        updates, state = rate.update({"w": jnp.ones(())}, state, params)
        steps.append(float(np.abs(jax.tree.leaves(updates)[0])))
    np.testing.assert_allclose(
        steps, 0.5 * CONFIG.train.learning_rate * (1 + np.cos(np.pi * np.arange(20) / 20)), rtol=1e-3
    )


def test_the_baseline_is_trained_beside_and_knows_no_prior(tmp_path):
    out = tmp_path / "run"
    config = replace(CONFIG, train=replace(CONFIG.train, epochs=8, baseline_share=0.5))
    train_with_baseline(DATA, config, Run(out, 0))
    rows = metrics(out / FRAME_BY_FRAME)
    assert len(rows) == 4
    assert all(row["type_nll"] == row["match_nll"] == 0 for row in rows)
    assert all(
        row["val_nll"] == pytest.approx(row["val_pos_logdet"] + row["val_pos_mahalanobis"]) for row in rows
    )
    sensor, there = load_sensor(out / FRAME_BY_FRAME)
    assert there.sensor.reference == "final"
    sample = sample_windows(DATA, jnp.arange(8), jax.random.key(3), config)
    moved = replace(
        sample.reading, tip_pos_estimate=sample.reading.tip_pos_estimate + jnp.array([0.01, 0.02, 0])
    )
    read = nnx.jit(lambda sensor, reading: sensor(reading).innovation)
    shift = read(sensor, moved) - read(sensor, sample.reading)
    np.testing.assert_allclose(shift, np.tile([0.01, 0.02], (8, 1)), atol=1e-5)
    before = files(out)
    train_with_baseline(DATA, config, Run(out, 0))
    assert files(out) == before
    alone = replace(config, train=replace(config.train, epochs=1, baseline_share=0.0))
    train_with_baseline(DATA, alone, Run(tmp_path / "b", 0))
    assert not (tmp_path / "b" / FRAME_BY_FRAME).exists()


@pytest.mark.parametrize("place", ["best", "last"])
def test_a_corrupt_checkpoint_is_refused_in_a_line(run, tmp_path, place):
    out = tmp_path / "run"
    shutil.copytree(run, out)
    for path in (out / "checkpoints" / place).rglob("*"):
        if path.is_file() and path.stat().st_size > 100:
            path.write_bytes(path.read_bytes()[:50])
    longer = replace(CONFIG, train=replace(CONFIG.train, epochs=EPOCHS + 1))
    use = (lambda: load_sensor(out)) if place == "best" else (lambda: train(DATA, longer, Run(out, 0)))
    with pytest.raises(RequestError, match=r"checkpoint: .* cannot be read") as caught:
        use()
    assert "\n" not in str(caught.value)


def test_arrays_keep_a_tree():
    tree = {"a": [np.arange(3), np.float32(2)], "b": {"c": np.ones((2, 2))}}
    back = from_arrays(tree, to_arrays(tree))
    jax.tree.map(np.testing.assert_array_equal, back, tree)


@pytest.mark.parametrize("from_host", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_training_through_sequences(from_host, tmp_path, monkeypatch):
    """Chains of three whole attempts, from the device and from the host; other data are refused."""
    data = make_episodes(EPISODES, actions=8, min_length=8, sequence=3)
    # The last attempt broke: nothing that stands in for an attempt that is not there may be NaN.
    wrench = data.rollout.felt.trace.wrench_sensor.at[-1].set(jnp.nan)
    valid = data.rollout.truth.valid.at[jnp.array([-1, 10, 11, 32])].set(False)
    data = replace(data, rollout=with_truth(with_trace(data.rollout, wrench_sensor=wrench), valid=valid))
    whole = replace(CONFIG.train, sequence=3, min_window=8, epochs=EPOCHS // 2, mirror=True)
    config = replace(CONFIG, train=whole)
    train(data, config, Run(tmp_path / "run", 0))
    rows = metrics(tmp_path / "run")
    assert rows[-1]["val_nll"] < rows[0]["val_nll"] - 0.5
    if from_host:
        monkeypatch.setattr("mjx_fit.training.loop.placed", lambda data: placed(data, free_bytes=0))
        train(data, config, Run(tmp_path / "host", 0))
        # Training amplifies the rounding of another program: the paths part after about eight epochs.
        for one, other in list(zip(rows, metrics(tmp_path / "host"), strict=True))[:5]:
            assert one == pytest.approx(other, rel=1e-5, abs=1e-5)
    asked = {"steps": 8, "config": config_to_tree(Config())}
    for request, message in (
        ({"sequence": 2, "sensor": "x"}, "their sequences have 2 attempts; collect them with --sequence 3"),
        ({"sequence": 3}, "start from sampled estimates; collect them with the --run of a sensor"),
        ({"sequence": 3, "sensor": "x", "steps": 9}, "train.min_window: 8 cannot be used .* at least 9"),
    ):
        with pytest.raises(RequestError, match=message):
            require_chains(asked | request, config)
    require_chains(asked | {"sequence": 3, "sensor": "x"}, config)
    require_chains(asked | {"sequence": 1}, CONFIG)


def test_members_of_an_ensemble_train_at_once_as_they_would_alone(run, tmp_path):
    few = replace(CONFIG, train=replace(CONFIG.train, epochs=4))

    def kill(row):
        if row["epoch"] == 1:
            raise KilledError

    out = tmp_path / "ensemble"
    with pytest.raises(KilledError):
        train(DATA, few, Run(out, 0, members=3), on_epoch=kill, checkpoint_every_s=0.0)
    train(DATA, few, Run(out, 0, members=3))
    curves = [metrics(out / f"member-{member}") for member in range(3)]
    for here, there in zip(curves[0], metrics(run), strict=False):
        assert here == pytest.approx(there, rel=1e-3, abs=1e-3)
    last = [curve[-1]["total"] for curve in curves]
    assert len(set(last)) == 3
    assert [len(curve) for curve in curves] == [4, 4, 4]
    # What each stores is what it was when its validation was best, and no other member's.
    kernels = []
    for member in range(3):
        sensor, _ = load_sensor(out / f"member-{member}")
        kernels.append(np.asarray(nnx.state(sensor)["trace_encoder"]["token"]["kernel"][...]))
    assert not any(np.allclose(kernels[a], kernels[b]) for a, b in ((0, 1), (0, 2), (1, 2)))
    whole = tmp_path / "whole"
    train(DATA, few, Run(whole, 0, members=3))
    assert [metrics(whole / f"member-{member}") for member in range(3)] == curves
    train(DATA, few, Run(tmp_path / "alone", 0, member=2))
    for here, there in zip(metrics(tmp_path / "alone"), curves[2], strict=True):
        assert here == pytest.approx(there, rel=1e-3, abs=1e-3)
    with pytest.raises(RequestError, match="it holds other files"):
        train(DATA, few, Run(run, 0, members=2))
    with pytest.raises(RequestError, match="--members: 0 is out of range"):
        train(DATA, few, Run(tmp_path / "none", 0, members=0))


@pytest.mark.parametrize(("best_nll", "is_worse"), [(0.7, False), (1.4, True)])
def test_a_run_says_when_its_sensor_is_worse_than_none(tmp_path, best_nll, is_worse):
    (tmp_path / run_files.RUN).write_text("{}")
    for epoch, nll in enumerate((1.9, best_nll)):
        run_files.append_metrics(tmp_path, {"epoch": epoch, "val_nll": nll, "prior_nll": 1.3})
    said = run_files.summary(tmp_path)
    assert f"validation NLL {best_nll:.3f} after epoch 2 of 2, 1.300 without the sensor" in said
    assert ("does not help yet" in said) == is_worse


def test_the_saver_waits_for_every_member_and_keeps_the_first_of_equals(tmp_path, monkeypatch):
    saved = []

    def save(folder, epochs_done, arrays):
        saved.append((folder.relative_to(tmp_path).parts[0], folder.name, epochs_done))

    monkeypatch.setattr("mjx_fit.training.saver.checkpoint.save", save)
    saver = Saver(tmp_path, [tmp_path / "a", tmp_path / "b"], math.inf, patience=2)
    saver.saved_at = time.monotonic()  # nothing is due before the end
    state = TrainState(nnx.State({}), nnx.State({}), ())
    for epoch, nll in enumerate([(3.0, 3.0), (3.0, 2.0), (4.0, 2.0), (4.0, 2.0)], start=1):
        assert not saved
        assert saver.after_epoch(epoch, state, np.array(nll), 99) is (epoch == 4)
        assert saver.best_epoch.tolist() == [1, min(epoch, 2)]
    assert saved == [("a", "best", 1), ("b", "best", 2), ("checkpoints", "last", 4)]
    assert not Saver(tmp_path, [tmp_path], 0.0, patience=0).is_stale(1000)


@pytest.mark.parametrize("replaced", [False, True])
def test_a_folder_that_is_taken_away_ends_the_training(tmp_path, replaced):
    out = tmp_path / "run"

    def taken_away(row):
        shutil.rmtree(out)
        if replaced:
            out.mkdir()

    with pytest.raises(WorkError, match="run was removed or replaced while this command was writing to it"):
        train(DATA, CONFIG, Run(out, 0), on_epoch=taken_away)
    assert not out.exists() or not list(out.iterdir())


def test_a_training_without_room_goes_on_when_there_is_some(tmp_path, monkeypatch):
    """At any moment of its own writing: no temporary file stays, and the curve is that of one that had it."""
    short = replace(CONFIG, train=replace(CONFIG.train, epochs=2))
    train(DATA, short, Run(tmp_path / "whole", 0))
    moment = 0
    while True:
        out = tmp_path / f"run{moment}"
        with monkeypatch.context() as patch:
            faults = Faults(patch, tmp_path, moment, errno.ENOSPC)
            if moment % 2:
                patch.setattr(os, "posix_fallocate", lambda *_: None)
            try:
                train(DATA, short, Run(out, 0))
            except OSError as error:
                named = str(error.filename)
        if not faults.failed:
            break
        assert named.startswith(str(out))
        assert not [path for path in out.rglob("*") if path.suffix in (".tmp", ".lock")]
        train(DATA, short, Run(out, 0))
        assert metrics(out) == metrics(tmp_path / "whole")
        moment += 6
    assert moment > 20
