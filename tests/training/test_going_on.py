"""Continuing a finished run, and starting a run from another: results agree with what is reported."""

import json
from dataclasses import fields, replace
from functools import partial
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from flax import nnx
from synthetic import make_episodes
from test_training import CONFIG, DATA, EPISODES, files, metrics

from mjx_fit.cli.main import main
from mjx_fit.config.schema import config_to_yaml
from mjx_fit.training import compatibility, run_files
from mjx_fit.training.checkpoint import BEST, LAST, fingerprint_of, load, load_sensor
from mjx_fit.training.loop import train
from mjx_fit.training.loss import Loss
from mjx_fit.training.run import Run
from mjx_fit.training.train import FRAME_BY_FRAME, train_with_baseline
from mjx_fit.utils.errors import RequestError

OTHER_DATA = make_episodes(60, actions=12, min_length=6, seed=7)


def quick_epoch(recipe, state, data, sides, key, val_key):
    """In the place of an epoch: moves the weights by its key and the learning rate, and compiles nothing."""
    bits = np.asarray(jax.random.key_data(key)).reshape(-1, 2)
    chance = bits.sum(1) / 2**33
    by = np.asarray(recipe.config.train.learning_rate * chance, np.float32)
    state = jax.tree.map(np.asarray, state)

    def moved(leaf):
        return leaf + (by.reshape(-1, *[1] * (leaf.ndim - 1)) if len(by) > 1 else by[0])

    def counted(leaf):
        return leaf + (leaf.dtype.kind == "i")

    opt_state = jax.tree.map(counted, state.opt_state)
    state = replace(state, params=jax.tree.map(moved, state.params), opt_state=opt_state)
    loss = Loss(**{field.name: chance for field in fields(Loss)})
    return state, loss, loss


@pytest.fixture(autouse=True)
def quick(request, monkeypatch):
    if "real" not in request.node.name:
        monkeypatch.setattr("mjx_fit.training.loop.run_epoch", quick_epoch)


def with_train(config=CONFIG, **fields):
    return replace(config, train=replace(config.train, **fields))


def of(checkpoint):
    assert checkpoint is not None
    return checkpoint


def weights(out):
    """All that the checkpoints of a run hold."""
    found = {}
    for place in (BEST, LAST):
        for path in sorted(out.rglob(str(place))):
            step, arrays = of(load(path))
            found |= {f"{path.relative_to(out)}/{step}/{name}": leaf for name, leaf in arrays.items()}
    return found


def require_same(one, other):
    here, there = weights(one), weights(other)
    assert here.keys() == there.keys()
    for name in here:
        np.testing.assert_array_equal(here[name], there[name], err_msg=name)
    for path in sorted(one.rglob("metrics.jsonl")):
        assert metrics(path.parent) == metrics(other / path.relative_to(one).parent)
    for path in sorted(one.rglob("config.yaml")):
        assert path.read_bytes() == (other / path.relative_to(one)).read_bytes()


@pytest.fixture
def run(tmp_path):
    """A short run with its baseline."""
    out = tmp_path / "first"
    assert train_with_baseline(DATA, with_train(epochs=2, baseline_share=0.5), Run(out, 0))
    return out


@pytest.mark.parametrize("members", [pytest.param(1, id="real", marks=pytest.mark.slow), 1, 2])
def test_more_epochs_come_to_what_as_many_from_the_start_come_to(tmp_path, members):
    few, more = (with_train(epochs=epochs, baseline_share=0.5) for epochs in (2, 4))

    def both(config, out):
        return train_with_baseline(DATA, config, Run(out, 0, members))

    assert both(config=few, out=tmp_path / "a")
    assert both(config=more, out=tmp_path / "a")
    assert both(config=more, out=tmp_path / "b")
    require_same(tmp_path / "a", tmp_path / "b")
    before = files(tmp_path / "a")
    assert not both(config=more, out=tmp_path / "a")
    assert not both(config=few, out=tmp_path / "a")
    assert files(tmp_path / "a") == before


@pytest.mark.parametrize("schedule", ["constant", "cosine"])
def test_more_patience_goes_on_after_an_early_stop(tmp_path, schedule):
    still = partial(with_train, epochs=24, schedule=schedule)
    train(DATA, still(patience=2), Run(tmp_path / "a", 0))
    stopped = len(metrics(tmp_path / "a"))
    assert stopped < 24
    assert "stopped early" in run_files.ended(tmp_path / "a", still(patience=2))
    assert not train(DATA, still(patience=2), Run(tmp_path / "a", 0))
    assert train(DATA, still(patience=4), Run(tmp_path / "a", 0))
    train(DATA, still(patience=4), Run(tmp_path / "b", 0))
    require_same(tmp_path / "a", tmp_path / "b")
    for less in (1, 2, 3):
        with pytest.raises(RequestError, match=rf"train\.patience: {less} cannot be used: .* may only grow"):
            train(DATA, still(patience=less), Run(tmp_path / "a", 0))
    assert train(DATA, still(patience=0), Run(tmp_path / "a", 0))
    assert len(metrics(tmp_path / "a")) == 24
    with pytest.raises(RequestError, match=r"train\.patience: 5 .*has 0 \(never stop early\)"):
        train(DATA, still(patience=5), Run(tmp_path / "a", 0))


def test_a_cosine_run_says_why_it_does_not_go_on_and_what_does(tmp_path):
    waved = partial(with_train, schedule="cosine")
    train(DATA, waved(epochs=1), Run(tmp_path / "run", 0))
    for epochs in (2, 9):
        with pytest.raises(RequestError, match=r"cosine brings the .* to zero; .*--init") as caught:
            train(DATA, waved(epochs=epochs), Run(tmp_path / "run", 0))
        assert "\n" not in str(caught.value)
    assert "cosine has ended; use --init" in run_files.ended(tmp_path / "run", waved(epochs=1))


def test_a_run_starts_from_anothers_best_sensor(run, tmp_path):
    """With a learning rate of almost nothing it stays what it was, its input scaling among it."""
    still = with_train(epochs=1, baseline_share=0.5, learning_rate=1e-12)
    out = tmp_path / "run"
    train_with_baseline(OTHER_DATA, still, Run(out, 3, init=run))
    for inside in ("", FRAME_BY_FRAME):
        one, other = (nnx.to_flat_state(nnx.state(load_sensor(x / inside)[0])) for x in (run, out))
        for (name, before), (_, after) in zip(one, other, strict=True):
            np.testing.assert_allclose(before[...], after[...], rtol=0, atol=1e-9, err_msg=str(name))
        told = json.loads((out / inside / "run.json").read_text())["init"]
        assert told["sensor"] == fingerprint_of(load_sensor(run / inside)[0])
        assert told["seed"] == 0
    _, last = of(load(out / LAST))
    assert any(name.startswith("opt_state") for name in last)
    assert [int(leaf) for name, leaf in last.items() if name.endswith("count")] == [1]
    assert "init" not in json.loads((run / "run.json").read_text())


def test_a_start_that_was_killed_goes_on_with_the_same_and_no_other(run, tmp_path):
    more = with_train(epochs=3)
    other = tmp_path / "other"
    train(OTHER_DATA, with_train(epochs=1), Run(other, 0))

    def start(out, init, **options):
        return train(OTHER_DATA, more, Run(out, 1, init=init), **options)

    def kill(row):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        start(tmp_path / "a", init=run, on_epoch=kill)
    for init, why in (
        (None, "--init: none cannot be used"),
        (run / FRAME_BY_FRAME, "sensor.reference"),
        (other, ""),
    ):
        with pytest.raises(RequestError, match=why or "--init: ") as caught:
            start(tmp_path / "a", init=init)
        assert "\n" not in str(caught.value)
    assert start(tmp_path / "a", init=run)
    assert start(tmp_path / "b", init=run)
    require_same(tmp_path / "a", tmp_path / "b")
    assert not start(tmp_path / "a", init=run)
    with pytest.raises(RequestError, match=r"--init: this one cannot be used: .* started from new weights"):
        train(DATA, with_train(epochs=2, baseline_share=0.5), Run(run, 0, init=tmp_path / "a"))


@pytest.mark.parametrize(
    ("config", "why"),
    [
        (
            replace(CONFIG, sensor=replace(CONFIG.sensor, feedforward=8)),
            "sensor.feedforward is 16 there and 8 here",
        ),
        (replace(CONFIG, sensor=replace(CONFIG.sensor, positional=False)), "sensor.positional is True there"),
        (
            replace(CONFIG, scene=replace(CONFIG.scene, shapes=CONFIG.scene.shapes[::-1])),
            "scene.shapes is ",
        ),
    ],
)
def test_another_network_is_refused_in_a_line(run, tmp_path, config, why):
    with pytest.raises(RequestError, match=f"^--init: .* cannot be used: {why}") as caught:
        train(OTHER_DATA, with_train(config, epochs=1), Run(tmp_path / "a", 1, init=run))
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "a").exists()


def test_other_dropout_and_other_settings_of_training_are_allowed(run, tmp_path):
    config = replace(CONFIG, sensor=replace(CONFIG.sensor, dropout=0.0))
    config = with_train(config, epochs=1, learning_rate=1e-4, batch_size=16, schedule="cosine")
    assert train(OTHER_DATA, config, Run(tmp_path / "a", 1, init=run))


def test_what_is_no_run_is_refused_by_its_option(run, tmp_path):
    (tmp_path / "empty").mkdir()
    for init, why in ((tmp_path / "nowhere", "no such folder"), (tmp_path / "empty", "not a training run")):
        with pytest.raises(RequestError, match=f"^--init: .*{why}"):
            train(OTHER_DATA, with_train(epochs=1), Run(tmp_path / "a", 1, init=init))
    assert not (tmp_path / "a").exists()


def test_a_sensor_is_not_validated_on_what_it_was_trained_on(run, tmp_path):
    """The holes of its training may be shared only where they are divided as they were."""
    one = with_train(epochs=1)
    for seed, config in ((1, one), (0, with_train(epochs=1, validation_fraction=0.5))):
        with pytest.raises(RequestError, match="it has seen what it would be validated on") as caught:
            train(DATA, config, Run(tmp_path / "a", seed, init=run))
        assert "\n" not in str(caught.value)
    part = jax.tree.map(lambda leaf: leaf[: EPISODES // 2], DATA)
    with pytest.raises(RequestError, match="it has seen"):
        train(part, one, Run(tmp_path / "a", 0, init=run))
    assert train(DATA, one, Run(tmp_path / "a", 0, init=run))
    # A run that starts from this one has its history.
    assert train(OTHER_DATA, one, Run(tmp_path / "b", 5, init=tmp_path / "a"))
    with pytest.raises(RequestError, match="it has seen"):
        train(DATA, one, Run(tmp_path / "c", 1, init=tmp_path / "b"))
    told = json.loads((tmp_path / "b" / "run.json").read_text())
    assert [step["seed"] for step in compatibility.lineage(told)] == [5, 0, 0]
    with pytest.raises(RequestError, match="--data: the data that the run was trained on"):
        compatibility.require_new(tmp_path / "b", DATA, json.loads((run / "run.json").read_text())["data"])
    with pytest.raises(RequestError, match="--data: the holes that the run was trained at"):
        compatibility.require_new(tmp_path / "b", part, "another")


def test_members_start_from_one_sensor_or_from_the_same_member(run, tmp_path):
    still = partial(with_train, learning_rate=1e-12)
    train(OTHER_DATA, still(epochs=1), Run(tmp_path / "two", 1, members=2, init=run))
    train(DATA, with_train(epochs=1), Run(tmp_path / "own", 0, members=2))
    train(OTHER_DATA, still(epochs=1), Run(tmp_path / "each", 1, members=2, init=tmp_path / "own"))

    def of(out):
        leaves = jax.tree.leaves(nnx.state(load_sensor(out)[0]))
        return np.concatenate([np.ravel(leaf) for leaf in leaves])

    for out, begin in (("two", (run, run)), ("each", (tmp_path / "own/member-0", tmp_path / "own/member-1"))):
        for member in range(2):
            now = of(tmp_path / out / f"member-{member}")
            np.testing.assert_allclose(now, of(begin[member]), rtol=0, atol=1e-9)
    assert np.abs(of(tmp_path / "own/member-0") - of(tmp_path / "own/member-1")).max() > 1e-3
    with pytest.raises(RequestError, match=r"--members: 3 cannot be used: --init .* holds 2 sensors"):
        train(OTHER_DATA, still(epochs=1), Run(tmp_path / "more", 1, members=3, init=tmp_path / "own"))
    with pytest.raises(RequestError, match=r"--init: .* holds 2 sensors; name one, e.g. .*member-0"):
        train(OTHER_DATA, still(epochs=1), Run(tmp_path / "more", 1, init=tmp_path / "own"))


def test_it_says_that_it_compiles_before_it_does(tmp_path, capsys, monkeypatch):
    def compiles(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("mjx_fit.training.loop.run_epoch", compiles)
    with pytest.raises(KeyboardInterrupt):
        train(DATA, with_train(epochs=2), Run(tmp_path / "run", 0))
    assert "epoch: 0/2, compiling: the first part takes longest" in capsys.readouterr().err


def test_a_finished_run_repeated_says_that_nothing_was_left(tmp_path, capsys, monkeypatch):
    """By the command, which says so of an early stop, too."""
    monkeypatch.setattr("mjx_fit.training.train.train_from", partial(_train_on_data, DATA))
    monkeypatch.setattr("mjx_fit.data.manifest.read_manifest", lambda folder: SimpleNamespace(part=(0, 1)))
    whole = tmp_path / "config.yaml"
    whole.write_text(config_to_yaml(with_train(epochs=24, patience=2, baseline_share=0.0)))
    command = ["train", "--data", "set", "--out", str(tmp_path / "run"), "--config", str(whole)]
    early = "stopped early after"
    for more, said in (
        ([], [early]),
        ([], ["nothing was left to do", early]),
        (["--set", "train.patience=0"], []),
        (["--set", "train.patience=0"], ["nothing was left to do: all 24 epochs are done"]),
    ):
        assert main([*command, *more]) == 0
        out = capsys.readouterr().out
        assert all(words in out for words in said)
        assert ("nothing was left" in out) == any("nothing" in words for words in said)


def _train_on_data(data, _folder, *asked):
    return train_with_baseline(data, *asked)
