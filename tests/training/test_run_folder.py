"""The files of a run: damaged, held, or without room. Training itself is elsewhere."""

import errno
import json
import os
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from synthetic import make_episodes

from mjx_fit.config.schema import Config, config_to_yaml
from mjx_fit.training import checkpoint, compatibility, run_files, run_folder, saver
from mjx_fit.training.loop import train
from mjx_fit.training.run import Lineage, Run
from mjx_fit.training.train import train_with_baseline
from mjx_fit.utils import locks
from mjx_fit.utils.errors import RequestError

ROW = {"epoch": 0, "val_nll": 1.0, "prior_nll": 2.0}
NO_DATA: Any = None
DEEP = "[" * 100_000


@pytest.fixture
def run(tmp_path) -> Path:
    (tmp_path / "config.yaml").write_text(config_to_yaml(Config()))
    (tmp_path / "run.json").write_text(json.dumps({"seed": 0, "data": "d"}))
    write_rows(tmp_path, *(ROW | {"epoch": epoch} for epoch in range(3)))
    return tmp_path


def write_rows(out: Path, *rows) -> None:
    lines = [row if isinstance(row, str) else json.dumps(row) for row in rows]
    (out / "metrics.jsonl").write_text("".join(f"{line}\n" for line in lines))


RUNS = [b"", b"{", b"null", b"[]", b'"seed"', b"7", b"\xff\xfe", DEEP.encode(), b"9" * 5000]


@pytest.mark.parametrize("content", RUNS)
@pytest.mark.parametrize(
    ("read", "option"),
    [
        (lambda run: run_folder.check(run, Config(), Lineage(0, "d")), "--out"),
        (run_files.summary, "--out"),
        (lambda run: compatibility.require_new(run, make_episodes(2), "d"), "--run"),
    ],
)
def test_a_damaged_run_json_is_named_in_a_line(read, option, content, run):
    (run / "run.json").write_bytes(content)
    with pytest.raises(RequestError, match=r"run\.json cannot be used: it is damaged") as caught:
        read(run)
    assert str(caught.value).startswith(f"{option}: {run}")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize(
    ("content", "read"),
    [
        (b'{"seed": 0}', lambda run: run_folder.check(run, Config(), Lineage(0, "d"))),
        (b'{"training": 7}', run_files.summary),
        (b'{"training": {"interactions": "many", "holes": 1}}', run_files.summary),
    ],
)
def test_a_run_json_that_lacks_something(content, read, run):
    (run / "run.json").write_bytes(content)
    with pytest.raises(RequestError, match=r"run\.json cannot be used: it is damaged"):
        read(run)


ROWS = [
    "",
    "{",
    "null",
    "[]",
    "7",
    DEEP,
    "{}",
    ROW | {"epoch": 2},
    {"epoch": 1},
    ROW | {"epoch": 1, "val_nll": "x"},
]


@pytest.mark.parametrize("row", ROWS)
def test_a_damaged_line_of_metrics_is_named_and_left(row, run):
    write_rows(run, ROW, row, ROW | {"epoch": 2})
    before = (run / "metrics.jsonl").read_bytes()
    for read in (lambda: run_files.keep_metrics(run, 3), lambda: run_files.summary(run)):
        with pytest.raises(
            RequestError, match=r"metrics\.jsonl cannot be used: it is damaged \(line 2: "
        ) as caught:
            read()
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 500
    assert (run / "metrics.jsonl").read_bytes() == before


@pytest.mark.parametrize("torn", ["", "{", json.dumps(ROW | {"epoch": 2})[:-5], "\udcff\0"])
def test_what_a_kill_tears_is_cut(torn, run):
    write_rows(run, ROW, ROW | {"epoch": 1})
    kept = (run / "metrics.jsonl").read_bytes()
    (run / "metrics.jsonl").write_bytes(kept + torn.encode(errors="surrogateescape"))
    run_files.keep_metrics(run, 2)
    assert (run / "metrics.jsonl").read_bytes() == kept


def test_metrics_that_lack_epochs_are_no_curve(run):
    for left in (2, 0):
        write_rows(run, *(ROW | {"epoch": epoch} for epoch in range(left)))
        with pytest.raises(RequestError, match=f"it ends after epoch {left}, but the checkpoint after 3"):
            run_files.keep_metrics(run, 3)
    with pytest.raises(RequestError, match="it holds no epoch"):
        run_files.summary(run)


@pytest.mark.parametrize("content", [b"", b"\xff", b"{", b"- 1", b"\0"])
def test_a_damaged_configuration_is_refused(content, run):
    (run / "config.yaml").write_bytes(content)
    changed = Config() if content else Config(train=Config().train.__class__(batch_size=7))
    with pytest.raises(RequestError) as caught:
        run_folder.check(run, changed, Lineage(0, "d"))
    assert str(run) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_start_that_was_killed_is_no_other_run(tmp_path):
    (tmp_path / "config.yaml").write_text(config_to_yaml(Config()))
    for name in ("config.yaml.tmp", "config.yaml.0123abcd.tmp", "run.json.89abcdef.tmp", ".lock"):
        (tmp_path / name).write_bytes(b"{")
    run_folder.check(tmp_path, Config(), Lineage(0, "d"))
    (tmp_path / "config.yaml").write_text("mine: 1")
    with pytest.raises(RequestError, match=r"it holds other files \(config\.yaml\)"):
        run_folder.check(tmp_path, Config(), Lineage(0, "d"))
    (tmp_path / "config.yaml").unlink()
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(RequestError, match=r"it holds other files \(thesis\.tex\)"):
        run_folder.check(tmp_path, Config(), Lineage(0, "d"))


@pytest.mark.parametrize("members", [1, 2])
@pytest.mark.parametrize("begin", [train, train_with_baseline])
def test_two_trainings_in_a_folder(begin, members, tmp_path):
    """The second is refused before it looks at anything: there or in any member's folder."""
    places = [tmp_path] if members == 1 else [tmp_path, tmp_path / "member-1"]
    for place in places:
        held, done = threading.Event(), threading.Event()

        def hold(place=place, held=held, done=done):
            with locks.holding(place):
                held.set()
                done.wait(60)

        other = threading.Thread(target=hold)
        other.start()
        held.wait(60)
        try:
            with pytest.raises(RequestError, match=f"{place} is in use: another process"):
                begin(NO_DATA, Config(), Run(tmp_path, 0, members))
        finally:
            done.set()
            other.join()
    assert not list(tmp_path.iterdir())


ARRAYS = {"a": np.zeros(1000)}


def _raised(error: BaseException, cause: BaseException | None = None):
    error.__cause__ = cause
    return error


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (OSError(errno.ENOSPC, "x"), errno.ENOSPC),
        (_raised(RuntimeError("task"), OSError(errno.EMFILE, "x")), errno.EMFILE),
        (ExceptionGroup("tasks", [ValueError("?"), OSError(errno.EDQUOT, "x")]), errno.EDQUOT),
        (
            ValueError("OUT_OF_RANGE: Failed to write 1217 bytes: File too large [os_error_code='27']"),
            errno.EFBIG,
        ),
        (ValueError("RESOURCE_EXHAUSTED: Error writing: No space left on device"), errno.ENOSPC),
        (_raised(KeyError("a"), ValueError("INTERNAL: EIO: Input/output error")), errno.EIO),
        (ValueError("the arrays are odd"), None),
    ],
)
def test_whatever_the_storage_library_raises_for_want_of_room(error, code, tmp_path, monkeypatch):
    def save(*_):
        raise error

    monkeypatch.setattr(checkpoint, "save", save)
    hook = threading.excepthook
    with pytest.raises(type(error) if code is None else OSError) as caught:
        saver._save(tmp_path / "checkpoints" / "last", 1, ARRAYS)
    if code is not None:
        assert (caught.value.errno, caught.value.filename) == (code, str(tmp_path / "checkpoints" / "last"))
    assert threading.excepthook is hook


@pytest.mark.parametrize("call", ["posix_fallocate", "dup"])
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EMFILE, errno.EIO])
def test_whether_there_is_room_is_found_out_before(call, code, tmp_path, monkeypatch):
    def refused(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(checkpoint, "save", lambda *_: pytest.fail("it began to write"))
    monkeypatch.setattr(os, call, refused)
    with pytest.raises(OSError, match=f"{os.strerror(code)}: '{tmp_path}/last'"):
        saver._save(tmp_path / "last", 1, ARRAYS)
    assert [str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")] == ["last"]
