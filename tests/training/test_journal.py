"""Event files of a training run, read back record by record as TensorBoard does."""

import json
import struct
import sys

import pytest

from mjx_fit.training.journal import Journal, require_tensorboard
from mjx_fit.utils.errors import RequestError

event_pb2 = pytest.importorskip("tensorboardX.proto.event_pb2")


def row(epoch: int, by: float = 0.0) -> dict:
    nll = 2.0 - epoch + by
    return {"epoch": epoch, "nll": nll, "val_nll": nll + 0.5, "prior_nll": 3.0, "seconds": 1.0}


def events(folder) -> list:
    """Return the events of all files of a folder, in the order in which they were written."""
    found = []
    for path in folder.glob("events.out.tfevents.*"):
        content = path.read_bytes()
        while content:  # length, checksum of it, the event, and its checksum
            (length,) = struct.unpack("<Q", content[:8])
            found.append(event_pb2.Event.FromString(content[12 : 12 + length]))
            content = content[16 + length :]
    return sorted(found, key=lambda event: event.wall_time)


def scalars(folder) -> dict:
    """Return the values as TensorBoard shows them: a restart drops what came before from its step on."""
    shown = {}
    for event in events(folder):
        if event.HasField("session_log"):
            shown = {key: value for key, value in shown.items() if key[1] < event.step}
        for value in event.summary.value:
            shown[value.tag, event.step] = value.simple_value
    return shown


def test_each_member_has_its_metrics_and_a_resumed_run_drops_what_it_trains_again(tmp_path):
    folders = [tmp_path / "member-0", tmp_path / "member-1"]
    for folder in folders:
        folder.mkdir()
    with Journal(folders, 0, tensorboard=True) as journal:
        for epoch in range(3):
            journal.append([row(epoch), row(epoch, 10.0)])
    with Journal(folders, 1, tensorboard=True) as journal:
        journal.append([row(1, 0.25), row(1, 10.25)])
    for folder, by in zip(folders, (0.0, 10.0), strict=True):
        wanted = {0: row(0, by), 1: row(1, by + 0.25)}
        lines = (folder / "metrics.jsonl").read_text().splitlines()
        assert [json.loads(line) for line in lines] == list(wanted.values())
        assert scalars(folder) == {
            (chart, epoch): pytest.approx(wanted[epoch][name])
            for epoch in wanted
            for chart, name in (
                ("training/nll", "nll"),
                ("validation/nll", "val_nll"),
                ("validation/prior_nll", "prior_nll"),
                ("training/seconds", "seconds"),
            )
        }


def test_without_the_flag_there_are_no_event_files(tmp_path):
    with Journal([tmp_path], 0, tensorboard=False) as journal:
        journal.append([row(0)])
    assert [path.name for path in tmp_path.iterdir()] == ["metrics.jsonl"]


def test_a_missing_library_is_told_before_anything_is_written(monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorboardX", None)
    with pytest.raises(RequestError, match=r"--tensorboard needs tensorboardX.*mjx-fit\[tensorboard\]"):
        require_tensorboard()
