"""Collections that are killed, meet each other, or run out of room."""

import os
import random
import shutil
import signal
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from collecting import command, files_of, run
from faults import NO_ROOM, Faults, Killed

from mjx_fit.data import hdf5, reader
from mjx_fit.data.manifest import read_manifest
from mjx_fit.data.merge import merge
from mjx_fit.utils import locks
from mjx_fit.utils.errors import RequestError, WorkError

SMALL = {"episodes": 40, "actions": 4, "batch": 4, "policy": "mixed", "engine": "native", "sequence": 2}


MOMENTS, MOMENTS_WITH_ROOM = 3 + 6 * 6 + 2, 3 + 6 * 5
"""In a collection of two shards the new folder is made, and synced in the one above it, and the lock is made;
then the manifest, twice a shard and the manifest, and the manifest once more are each created, written,
synced, renamed (before and after) and synced in the folder; the lock is removed, and would be a folder that
stayed empty. Once a file is renamed it needs no more room, nor does removing."""


@pytest.fixture(scope="module")
def folder(collect, tmp_path_factory):
    return collect(tmp_path_factory.mktemp("data") / "set")


@pytest.fixture
def recall(folder, collect, monkeypatch):
    """Collects what is in the folder, but recalls its episodes instead of simulating them again."""
    told = read_manifest(folder)
    shards = reader.read_shards(folder, told.shards, told.request)
    parts = {int(part.episode[0]): part for part in shards}

    class Recalled:
        broken = 0

        def __init__(self, *_):
            pass

        def __call__(self, start):
            return parts[start]

    monkeypatch.setattr("mjx_fit.data.collect.Sequences", Recalled)
    return collect


def test_same_seed_same_bytes_and_a_repeat_changes_nothing(folder, collect, tmp_path):
    collect(tmp_path / "again")
    assert files_of(tmp_path / "again") == files_of(folder)
    stamps = {path: path.stat().st_mtime_ns for path in folder.iterdir()}
    collect(folder)
    assert stamps == {path: path.stat().st_mtime_ns for path in folder.iterdir()}


def test_killed_at_any_file_operation_it_goes_on_to_the_same_bytes(folder, recall, tmp_path, monkeypatch):
    moments = 0
    while True:
        out = tmp_path / f"killed{moments}"
        with monkeypatch.context() as patch:
            Faults(patch, tmp_path, moments)
            try:
                recall(out)
                break
            except Killed:
                pass
        if (out / "manifest.json").exists():
            assert reader.damages(out) == {}  # what the manifest names is whole
        recall(out)
        assert files_of(out) == files_of(folder)
        moments += 1
    assert moments == MOMENTS


def test_a_merge_killed_at_any_file_operation_goes_on(folder, collect, tmp_path, monkeypatch):
    parts = [collect(tmp_path / f"part{i}", shard_index=i, num_shards=2) for i in range(2)]
    for moment in range(MOMENTS):
        out = tmp_path / f"killed{moment}"
        with monkeypatch.context() as patch:
            Faults(patch, tmp_path, moment)
            with pytest.raises(Killed):
                merge(parts, out)
        merge(parts, out)
        assert files_of(out) == files_of(folder)


def test_dumps_of_parts_are_merged_whole_and_through_no_link(collect, tmp_path, monkeypatch):
    parts = [collect(tmp_path / f"part{i}", shard_index=i, num_shards=2) for i in range(2)]
    dump, other, out = parts[1] / "broken" / "broken-00000007.npz", tmp_path / "other", tmp_path / "out"
    dump.parent.mkdir()
    dump.write_bytes(b"a state")
    other.mkdir()
    (other / dump.name).write_bytes(b"precious")
    out.mkdir()
    (out / "broken").symlink_to(other)
    with pytest.raises(RequestError, match="broken cannot be used: it is a symbolic link"):
        merge(parts, out)
    (out / "broken").unlink()
    (out / "broken").mkdir()
    (out / "broken" / dump.name).symlink_to(other / dump.name)  # replaced as an entry
    merge(parts, out)
    assert (out / "broken" / dump.name).read_bytes() == b"a state"
    assert (other / dump.name).read_bytes() == b"precious"


def test_a_folder_that_is_taken_away_is_noticed(collect, tmp_path, monkeypatch):
    out, encode = tmp_path / "out", hdf5.encode

    def taken_away(*args):
        monkeypatch.setattr(hdf5, "encode", encode)
        shutil.rmtree(out)
        collect(out, seed=6)  # somebody else's
        return encode(*args)

    monkeypatch.setattr(hdf5, "encode", taken_away)
    with pytest.raises(WorkError, match="was removed or replaced"):
        collect(out)
    assert reader.damages(out) == {}
    assert read_manifest(out).request["seed"] == 6


def test_killed_for_real(collect, tmp_path):
    """Once, and then to the end; the slow test does it at fifty moments."""
    whole = collect(tmp_path / "whole", **SMALL, seed=0)
    out = tmp_path / "out"
    process = subprocess.Popen(command(out, **SMALL), stderr=subprocess.DEVNULL)
    wait_for(lambda: len(list(out.glob("*.h5"))) >= 4, process)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert len(list(out.glob("*.h5"))) < len(list(whole.glob("*.h5"))) == 10
    assert run(command(out, **SMALL)).returncode == 0
    assert files_of(out) == files_of(whole)


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_killed_at_fifty_random_moments(collect, tmp_path):
    whole = files_of(collect(tmp_path / "whole", **SMALL, seed=0))
    began = time.monotonic()
    assert run(command(tmp_path / "timed", **SMALL)).returncode == 0
    seconds = time.monotonic() - began
    moments, shards_there = random.Random(0), []
    for i in range(50):
        out = tmp_path / f"out{i}"
        process = subprocess.Popen(command(out, **SMALL), stderr=subprocess.DEVNULL)
        if i % 2:  # at work, and not while it still imports
            wait_for((out / "shard-00000000.h5").exists, process)
            time.sleep(moments.uniform(0, 0.4))
        else:
            time.sleep(moments.uniform(0, seconds))
        process.send_signal(signal.SIGKILL)
        process.wait()
        shards_there.append(len(list(out.glob("*.h5"))))
        assert not out.exists() or not (out / "manifest.json").exists() or reader.damages(out) == {}
        assert run(command(out, **SMALL)).returncode == 0
        assert files_of(out) == whole
        shutil.rmtree(out)
    print(f"shards at the moment of the kill: {sorted(shards_there)}")
    assert len(set(shards_there)) > 5


def wait_for(condition, process, seconds=100):
    began = time.monotonic()
    while not condition():
        assert process.poll() is None, "it ended before it could be killed"
        assert time.monotonic() - began < seconds
        time.sleep(0.005)


def test_a_second_collector_is_refused(collect, tmp_path):
    out = collect(tmp_path / "out")
    (out / "shard-00000005.h5").unlink()
    before = files_of(out)
    with locks.holding(out):
        with ThreadPoolExecutor(1) as other, pytest.raises(RequestError, match="another process is writing"):
            other.submit(collect, out).result()
        done = run(command(out, episodes=10, actions=3, policy="mixed", engine="native", seed=5, batch=5))
        assert done.returncode == 2
        assert done.stderr.count("\n") == 1
        assert files_of(out) == before
    collect(out)
    assert len(reader.load(out).episode) == 10


@pytest.mark.parametrize("code", NO_ROOM)
def test_a_full_disk_is_said_and_loses_nothing(folder, recall, tmp_path, monkeypatch, code):
    """At any file operation: the error names a path, no temporary file stays, and the command goes on."""
    for moment in range(0, MOMENTS_WITH_ROOM, 1 if code == NO_ROOM[0] else 9):
        out = tmp_path / f"full{moment}"
        with monkeypatch.context() as patch:
            Faults(patch, tmp_path, moment, code)
            with pytest.raises(OSError, match=os.strerror(code)) as caught:
                recall(out)
        assert caught.value.errno == code
        assert str(caught.value.filename).startswith(str(tmp_path))
        assert ".tmp" not in str(caught.value.filename)
        names = {path.name for path in out.iterdir()} if out.is_dir() else set()
        assert not {name for name in names if name.endswith(("tmp", "lock"))}
        if "manifest.json" in names:
            assert reader.damages(out) == {}
        recall(out)
        assert files_of(out) == files_of(folder)


def in_a_mount(options, script):
    """Runs a script in a name space of its own in which $DIR is a small file system."""
    mount = f'mkdir -p "$DIR" && mount -t tmpfs -o {options} none "$DIR" && '
    return ["unshare", "-rm", "sh", "-c", mount + script]


def can_mount(path):
    try:
        return run(in_a_mount("size=1m", "true"), env={**os.environ, "DIR": str(path)}).returncode == 0
    except FileNotFoundError:
        return False


def test_a_small_and_then_a_read_only_disk(tmp_path):
    """Real ones, where the system lets a user mount them."""
    if not can_mount(tmp_path / "mount"):
        pytest.skip("file systems cannot be mounted here")
    argv = " ".join(f"'{word}'" for word in command(Path("/out"), **{**SMALL, "batch": 8}))
    collecting = argv.replace("'/out'", '"$DIR/out"')
    check = collecting.split(" '--out'")[0].replace("'collect'", "'data' 'check'") + ' "$DIR/out"'
    script = (
        f'{collecting}; echo code $?; {check}; echo code $?; mount -o remount,ro "$DIR"; '
        f"{collecting}; echo code $?"
    )
    done = run(in_a_mount("size=200k", script), env={**os.environ, "DIR": str(tmp_path / "mount")})
    assert [line for line in done.stdout.splitlines() if "code" in line] == ["code 1", "code 0", "code 2"]
    assert "not complete: " in done.stdout
    said = [line for line in done.stderr.splitlines() if line.startswith("mjx-fit:")]
    assert "No space left on device" in said[0]
    assert "Read-only file system" in said[1]
    assert "Traceback" not in done.stderr
