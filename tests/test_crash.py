"""Collections that are killed, meet each other, or run out of room."""

import errno
import os
import random
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest
from collecting import command, files_of, run

from mjx_fit import files
from mjx_fit.dataset import manifest, shard, store
from mjx_fit.dataset.merge import merge
from mjx_fit.errors import RequestError, WorkError

SMALL = {"episodes": 40, "steps": 4, "batch": 4, "policy": "mixed", "engine": "native", "sequence": 2}


MOMENTS = 1 + 5 * 6
"""In a collection of two shards: the new folder is synced; then the manifest, twice a shard and the manifest,
and the manifest once more, are each written, synced, renamed (before and after) and synced in the folder."""


class Killed(BaseException):
    """Comes where SIGKILL would."""


@pytest.fixture(scope="module")
def folder(collect, tmp_path_factory):
    return collect(tmp_path_factory.mktemp("data") / "set")


def test_same_seed_same_bytes_and_a_repeat_changes_nothing(folder, collect, tmp_path):
    collect(tmp_path / "again")
    assert files_of(tmp_path / "again") == files_of(folder)
    stamps = {path: path.stat().st_mtime_ns for path in folder.iterdir()}
    collect(folder)
    assert stamps == {path: path.stat().st_mtime_ns for path in folder.iterdir()}


def kill_at(patch, moment):
    """Lets file operations happen until the given one, which happens by half or not at all."""
    count = iter(range(10**6))
    write, rename, sync = Path.write_bytes, Path.replace, files._sync

    def dying_write(path, content):
        if next(count) == moment:
            write(path, content[: len(content) // 2])
            raise Killed
        return write(path, content)

    def dying_rename(path, target):
        before, after = next(count), next(count)
        if before == moment:
            raise Killed
        rename(path, target)
        if after == moment:
            raise Killed

    def dying_sync(path):
        if next(count) == moment:
            raise Killed
        sync(path)

    patch.setattr(Path, "unlink", lambda *_, **__: None)  # nothing is tidied up by what is dead
    patch.setattr(Path, "write_bytes", dying_write)
    patch.setattr(Path, "replace", dying_rename)
    patch.setattr(files, "_sync", dying_sync)


def test_killed_at_any_file_operation_it_goes_on_to_the_same_bytes(folder, collect, tmp_path, monkeypatch):
    moments = 0
    while True:
        out = tmp_path / f"killed{moments}"
        with monkeypatch.context() as patch:
            kill_at(patch, moments)
            try:
                collect(out)
                break
            except Killed:
                pass
        if (out / "manifest.json").exists():
            assert store.damages(out) == {}  # what the manifest names is whole
        collect(out)
        assert files_of(out) == files_of(folder)
        moments += 1
    assert moments == MOMENTS


def test_a_merge_killed_at_any_file_operation_goes_on(folder, collect, tmp_path, monkeypatch):
    parts = [collect(tmp_path / f"part{i}", shard_index=i, num_shards=2) for i in range(2)]
    for moment in range(MOMENTS):
        out = tmp_path / f"killed{moment}"
        with monkeypatch.context() as patch:
            kill_at(patch, moment)
            with pytest.raises(Killed):
                merge(parts, out)
        merge(parts, out)
        assert files_of(out) == files_of(folder)


def test_a_folder_that_is_taken_away_is_noticed(collect, tmp_path, monkeypatch):
    out, encode = tmp_path / "out", shard.encode

    def taken_away(*args):
        monkeypatch.setattr(shard, "encode", encode)
        shutil.rmtree(out)
        collect(out, seed=6)  # somebody else's
        return encode(*args)

    monkeypatch.setattr(shard, "encode", taken_away)
    with pytest.raises(WorkError, match="was removed or replaced"):
        collect(out)
    assert store.damages(out) == {}
    assert manifest.read(out).request["seed"] == 6


def test_killed_for_real(collect, tmp_path):
    """Twice, and then to the end; the slow test does it at fifty moments."""
    whole = collect(tmp_path / "whole", **SMALL, seed=0)
    out = tmp_path / "out"
    for shards in (2, 6):
        process = subprocess.Popen(command(out, **SMALL), stderr=subprocess.DEVNULL)
        wait_for(lambda n=shards: len(list(out.glob("*.h5"))) >= n, process)
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
        assert not out.exists() or not (out / "manifest.json").exists() or store.damages(out) == {}
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
    with files.lock(out / ".lock"):
        with pytest.raises(RequestError, match="another process is writing to it"):
            collect(out)
        done = run(command(out, episodes=10, steps=3, policy="mixed", engine="native", seed=5, batch=5))
        assert done.returncode == 2
        assert done.stderr.count("\n") == 1
        assert files_of(out) == before
    collect(out)
    assert len(store.load(out).episode) == 10


def test_a_full_disk_is_said_and_loses_nothing(folder, collect, tmp_path, monkeypatch):
    out = tmp_path / "full"
    write = Path.write_bytes

    def no_room(path, content):
        if "shard-00000005" in path.name:
            write(path, content[:1000])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(path, content)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", no_room)
        with pytest.raises(OSError, match=r"No space left on device: .*shard-00000005\.h5"):
            collect(out)
    assert sorted(files_of(out)) == ["manifest.json", "shard-00000000.h5"]
    assert store.damages(out) == {}
    collect(out)
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
