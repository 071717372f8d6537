"""Temporary files, links, locks and paths: what is written goes where it was asked to, whole, and once."""

import errno
import fcntl
import os
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest
from faults import Faults, without

from mjx_fit.cli import main
from mjx_fit.config.schema import Config
from mjx_fit.evaluation import parts, result_file
from mjx_fit.training import run, run_files, run_folder
from mjx_fit.utils import files, filesystem, locks
from mjx_fit.utils.errors import RequestError, WorkError


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def by_bytes(path: Path) -> None:
    files.write_bytes(path, b"new")


def by_name(path: Path) -> None:
    files.replace_with(path, lambda temporary: temporary.write_bytes(b"new"))


WRITERS = pytest.mark.parametrize("write", [by_bytes, by_name])


# Temporary names


@WRITERS
@pytest.mark.parametrize("name", ["f.json.tmp", "f.json.0123abcd.tmp", "f.json"])
@pytest.mark.parametrize("kind", ["link", "dangling", "hard link", "fifo", "file"])
def test_what_is_planted_is_replaced_and_never_written_through(write, name, kind, tmp_path, monkeypatch):
    other, folder = tmp_path / "other", tmp_path / "folder"
    other.write_bytes(b"precious")
    folder.mkdir()
    plant = {
        "link": lambda path: path.symlink_to(other),
        "dangling": lambda path: path.symlink_to(tmp_path / "nowhere"),
        "hard link": lambda path: path.hardlink_to(other),
        "fifo": os.mkfifo,
        "file": lambda path: path.write_bytes(b"left by a kill"),
    }[kind]
    plant(folder / name)
    write(folder / "f.json")
    assert (folder / "f.json").read_bytes() == b"new"
    assert names(folder) == ["f.json"]
    assert other.read_bytes() == b"precious"
    assert names(tmp_path) == ["folder", "other"]


@WRITERS
@pytest.mark.parametrize("plant", [Path.symlink_to, Path.hardlink_to])
def test_a_name_that_was_guessed_is_not_used(write, plant, tmp_path, monkeypatch):
    other = tmp_path / "other"
    other.write_bytes(b"precious")
    guesses = iter(["0123abcd", "89abcdef"])
    monkeypatch.setattr(files.secrets, "token_hex", lambda _: next(guesses))
    monkeypatch.setattr(files, "_remove_dead", lambda path: plant(tmp_path / "f.0123abcd.tmp", other))
    write(tmp_path / "f")
    assert other.read_bytes() == b"precious"
    assert (tmp_path / "f").read_bytes() == b"new"


@WRITERS
def test_a_temporary_that_another_took_for_dead_is_made_again(write, tmp_path, monkeypatch):
    """Between making and locking."""
    real, removed = filesystem.try_lock, []

    def late(descriptor, path):
        if not removed:
            removed.extend(one.unlink() for one in tmp_path.glob("f.*.tmp"))
        return real(descriptor, path)

    monkeypatch.setattr(files, "try_lock", late)
    write(tmp_path / "f")
    assert removed == [None]
    assert (tmp_path / "f").read_bytes() == b"new"


@WRITERS
def test_a_writer_that_lives_keeps_its_temporary_file(write, tmp_path):
    with files._placing(tmp_path / "f") as (descriptor, temporary):
        os.write(descriptor, b"slow")
        write(tmp_path / "f")
        assert temporary.exists()
    assert (tmp_path / "f").read_bytes() == b"slow"
    assert names(tmp_path) == ["f"]


def test_where_there_are_no_locks_only_the_old_are_dead(tmp_path, monkeypatch):
    without(monkeypatch, fcntl, "flock", errno.ENOLCK)
    for name in ("f.00000000.tmp", "f.11111111.tmp"):
        (tmp_path / name).write_bytes(b"")
    os.utime(tmp_path / "f.00000000.tmp", (0, 0))
    files.write_bytes(tmp_path / "f", b"")
    assert names(tmp_path) == ["f", "f.11111111.tmp"]


def test_others_files_are_no_temporaries(tmp_path):
    theirs = [
        "f.json.tmp.bak",
        "f.json.0123.tmp",
        "g.json.0123abcd.tmp",
        "xf.json.tmp",
        "f.json.0123ABCD.tmp",
    ]
    ours = [".lock", "f.json.lock", "f.json.tmp", "f.json.0123abcd.tmp"]
    for name in (*theirs, *ours, "f.json"):
        (tmp_path / name).write_bytes(b"")
    assert files.foreign(tmp_path, {"f.json"}) == sorted(theirs)
    files.write_bytes(tmp_path / "f.json", b"")
    assert set(theirs) <= set(names(tmp_path))


@WRITERS
@pytest.mark.parametrize("umask", [0o022, 0o077, 0o002])
def test_permissions_are_what_the_umask_leaves(write, umask, tmp_path):
    before = os.umask(umask)
    try:
        write(tmp_path / "f")
    finally:
        os.umask(before)
    assert (tmp_path / "f").stat().st_mode & 0o777 == 0o666 & ~umask


@WRITERS
@pytest.mark.parametrize("letter", ["a", "ä", "€"])
def test_the_longest_names_can_be_written_and_held(write, letter, tmp_path):
    path = tmp_path / (letter * (255 // len(letter.encode())))
    with locks.holding_file(path):
        assert len(names(tmp_path)) == 1
        write(path)
    assert names(tmp_path) == [path.name]


def test_a_line_that_does_not_fit_leaves_the_lines_before(tmp_path, monkeypatch):
    files.append_line(tmp_path / "f", "one")
    with monkeypatch.context() as patch:
        Faults(patch, tmp_path, 1, errno.ENOSPC)
        with pytest.raises(OSError, match=f"No space left on device: '{tmp_path}/f'"):
            files.append_line(tmp_path / "f", "two")
    files.append_line(tmp_path / "f", "three")
    assert (tmp_path / "f").read_text() == "one\nthree\n"


# File systems without locks, or without syncing


@pytest.mark.parametrize(
    ("call", "code"),
    [((fcntl, "flock"), code) for code in ("ENOLCK", "ENOSYS", "EOPNOTSUPP", "ENOTSUP", "EINVAL", "EBADF")]
    + [((os, "fsync"), code) for code in ("ENOSYS", "EOPNOTSUPP", "ENOTSUP", "EINVAL", "EBADF")],
)
def test_what_a_file_system_lacks_is_done_without_and_said_once(call, code, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(filesystem, "_said", set())
    without(monkeypatch, call[0], call[1], getattr(errno, code))
    with locks.holding(tmp_path / "new") as hold:
        files.write_bytes(tmp_path / "new" / "f", b"1")
        files.append_line(tmp_path / "new" / "f", "2")
        hold.require()
    assert names(tmp_path / "new") == ["f"]
    assert (tmp_path / "new" / "f").read_text() == "12\n"
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert ("has no locks" if call[1] == "flock" else "cannot sync it") in said
    assert f"({os.strerror(getattr(errno, code))})" in said


@pytest.mark.parametrize("code", [errno.EIO, errno.ESTALE])
def test_other_errors_of_locks_name_their_path(code, tmp_path, monkeypatch):
    without(monkeypatch, fcntl, "flock", code)
    with pytest.raises(OSError, match=f"'{tmp_path}") as caught, locks.holding(tmp_path):
        pass
    assert caught.value.errno == code


def test_a_folder_that_cannot_be_opened_for_syncing(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(filesystem, "_said", set())
    real = os.open

    def opened(path, flags, *args, **kwargs):
        if path == tmp_path:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return real(path, flags, *args, **kwargs)

    monkeypatch.setattr(os, "open", opened)
    for name in "ab":
        files.write_bytes(tmp_path / name, b"")
    assert names(tmp_path) == ["a", "b"]
    assert capsys.readouterr().err.count("cannot be synced") == 1


# Links


def linked(folder: Path, name: str, target: Path) -> Path:
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / name).symlink_to(target)
    return folder


@pytest.mark.parametrize("to", ["folder", "file", "nowhere"])
@pytest.mark.parametrize(
    ("name", "write"),
    [
        (".lock", lambda out: locks.holding(out).__enter__()),
        ("r.json.lock", lambda out: locks.holding_file(out / "r.json").__enter__()),
        ("metrics.jsonl", lambda out: run_files.append_metrics(out, {})),
        ("r.parts", lambda out: parts.kept(out / "r.json")),
        ("r.parts", lambda out: parts.finish(out / "r.json")),
        ("r.broken", lambda out: result_file.broken(out / "r.json")),
        ("member-1", lambda out: run.members(out, 2)),
        ("frame_by_frame", lambda out: run.members(out, 1, "frame_by_frame")),
        ("member-0/frame_by_frame", lambda out: run.members(out, 2, "frame_by_frame")),
        *[
            (name, lambda out: run_folder.check(out, Config(), run.Lineage(0, "")))
            for name in ("config.yaml", "run.json", "metrics.jsonl", "checkpoints", "checkpoints/last")
        ],
    ],
)
def test_no_link_is_followed_where_something_is_written(name, write, to, tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "part-00000.json").write_bytes(b"precious")
    (tmp_path / "file").write_bytes(b"precious")
    out = linked(tmp_path / "out", name, tmp_path / to)
    with pytest.raises(RequestError, match=f"{name} cannot be used: it is a symbolic link"):
        write(out)
    assert (tmp_path / "file").read_bytes() == b"precious"
    assert names(tmp_path / "folder") == ["part-00000.json"]
    assert not (tmp_path / "nowhere").exists()


@pytest.mark.parametrize(
    "words",
    [
        ["collect", "--episodes", "4"],
        ["evaluate", "attempt", "--trials", "2"],
        ["paper", "--size", "quick"],
        ["demo"],
    ],
)
def test_a_dangling_link_and_a_loop_are_named(words, tmp_path, capsys):
    ending = ".json" if words[0] == "evaluate" else ""
    for name, target in ((f"dangling{ending}", "nowhere"), (f"loop{ending}", f"loop{ending}")):
        (tmp_path / name).symlink_to(target)
        assert main.main([*words, "--out", str(tmp_path / name)]) == 2
        said = capsys.readouterr().err
        assert f"{tmp_path / name} cannot be used: it is a dangling link (to {target})" in said
        assert said.count("\n") == 1
    assert not (tmp_path / "nowhere").exists()


def test_an_output_folder_may_be_a_link(tmp_path):
    (tmp_path / "scratch").mkdir()
    (tmp_path / "out").symlink_to("scratch")
    with locks.holding(tmp_path / "out"):
        files.write_text(tmp_path / "out" / "f", "ä")
    assert (tmp_path / "scratch" / "f").read_bytes() == "ä".encode()


# Locks


@contextmanager
def held_by_another(path: Path):
    """Another process, as far as the system can tell: a lock belongs to who opened the file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("ab") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def test_what_is_held_is_refused_to_others_until_it_is_released(tmp_path):
    out, file = tmp_path / "out", tmp_path / "r.json"
    with ThreadPoolExecutor(1) as pool:
        for holding, place, lock in (
            (locks.holding, out, out / ".lock"),
            (locks.holding_file, file, tmp_path / "r.json.lock"),
        ):

            def take(holding=holding, place=place):
                with holding(place):
                    return True

            with holding(place), holding(place):
                assert lock.exists()
                with pytest.raises(RequestError, match=f"{place} is in use: another process is writ"):
                    pool.submit(take).result()
            assert pool.submit(take).result()
            assert not lock.exists()
            with held_by_another(lock), pytest.raises(RequestError, match="another process"):
                take()
            assert lock.exists()  # as after a kill
            assert take()
            assert not lock.exists()
    assert names(tmp_path) == ["out"]  # it was there before


def test_a_folder_that_was_made_for_nothing_goes_again(tmp_path):
    def refused():
        with locks.holding(tmp_path / "a" / "b"):
            raise RequestError("no")

    with pytest.raises(RequestError, match="no"):
        refused()
    assert names(tmp_path) == []


def test_a_place_that_is_taken_away_is_noticed(tmp_path):
    def work(replaced):
        with locks.holding(tmp_path / "out"):
            (tmp_path / "out").rename(tmp_path / "gone")
            if replaced:
                (tmp_path / "out").mkdir()
                locks.require_all()
            files.append_line(tmp_path / "out" / "f", "line")

    for replaced in (False, True):
        with pytest.raises(WorkError, match="out was removed or replaced while this command was writing"):
            work(replaced)
        (tmp_path / "gone" / ".lock").unlink()
        (tmp_path / "gone").rmdir()


def test_who_waits_on_a_lock_that_is_being_removed_takes_the_next_one(tmp_path, monkeypatch):
    """Between opening and locking, who held it removes it: a lock on what others cannot meet is none."""
    real, lock = filesystem.try_lock, tmp_path / ".lock"
    removed = []

    def late(descriptor, path):
        if not removed:
            removed.append(lock.unlink())
        return real(descriptor, path)

    monkeypatch.setattr(locks, "try_lock", late)
    with locks.holding(tmp_path) as hold:
        assert hold.is_there()
        assert lock.exists()


def test_a_read_only_place_needs_no_lock_to_be_read(tmp_path, monkeypatch):
    def refused(path, flags, *_):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))

    monkeypatch.setattr(locks, "open_entry", refused)
    with locks.holding(tmp_path, even_if_read_only=True) as hold:
        hold.require()
    with pytest.raises(PermissionError, match=f"'{tmp_path}'"), locks.holding(tmp_path):
        pass


@pytest.mark.parametrize(
    ("words", "lock"),
    [
        (["collect", "--episodes", "4"], "out/.lock"),
        (["paper", "--size", "quick"], "out/.lock"),
        (["demo"], "out/.lock"),
        (["evaluate", "attempt", "--trials", "2"], "out.json.lock"),
        (["evaluate", "position", "--trials", "2"], "out.json.lock"),
        (["evaluate", "insertion", "--trials", "2"], "out.json.lock"),
        (["evaluate", "assembly", "--trials", "2"], "out.json.lock"),
    ],
)
def test_a_second_command_is_refused(words, lock, tmp_path, capsys):
    out = tmp_path / lock.split("/")[0].removesuffix(".lock")
    with held_by_another(tmp_path / lock):
        before = names(tmp_path)
        assert main.main([*words, "--out", str(out)]) == 2
        said = capsys.readouterr().err
        assert said == f"mjx-fit: --out: {out} is in use: another process is writing to it\n"
        assert names(tmp_path) == before


# Paths


@pytest.mark.parametrize("written", ["~/x", "~", "~/a/../x"])
def test_a_tilde_is_the_home_folder_in_every_option(written, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    expected = written.replace("~", str(tmp_path / "home"))
    for words in every_path_option():
        args = main.parser().parse_args([word.replace("PATH", written) for word in words])
        found = [value for value in vars(args).values() if isinstance(value, Path)]
        found += [one for value in vars(args).values() if isinstance(value, list) for one in value]
        assert Path(expected) in found, words


@pytest.mark.parametrize(
    ("written", "said"),
    [
        ("", "must name a file or a folder"),
        ("  ", "must name a file or a folder"),
        ("a\0b", "holds no NUL"),
        ("a\ud800b", "expected valid UTF-8"),
        ("~nobody-of-that-name/x", "no home folder of ~nobody-of-that-name is known"),
    ],
)
def test_what_can_be_no_path_is_refused_in_a_line(written, said, capsys):
    for words in every_path_option():
        assert main.main([word.replace("PATH", written) for word in words]) == 2
        err = capsys.readouterr().err
        assert said in err
        assert err.count("\n") == 1
        assert "Traceback" not in err


def every_path_option():
    """A command line for each option that is a path, at every command."""
    root = main.parser()
    found = []

    def walk(parser, words):
        for action in parser._actions:
            if isinstance(action.choices, dict):
                for name, sub in action.choices.items():
                    walk(sub, [*words, name])
        required = [action for action in parser._actions if action.required and action.choices is None]
        for action in parser._actions:
            if _is_path(action):
                others = [one for one in required if one is not action]
                found.append(
                    [*words, *_given(action, "PATH"), *(w for one in others for w in _given(one, "o"))]
                )

    walk(root, [])
    assert len(found) > 44
    return found


def _is_path(action) -> bool:
    return action.type is not None and action.type.__name__ in ("path", "run_path")


def _given(action, value) -> list[str]:
    return [f"{action.option_strings[0]}={value}"] if action.option_strings else [value]


@pytest.mark.parametrize("words", [["collect", "--episodes", "4"], ["evaluate", "attempt", "--trials", "2"]])
def test_paths_that_the_system_refuses_are_refused_in_a_line(words, tmp_path, capsys):
    (tmp_path / "file").write_bytes(b"")
    (tmp_path / "loop").symlink_to("loop")
    for place in ("a" * 300, "file/x", "file/x/y", "loop/x", "b" * 300 + "/x"):
        assert main.main([*words, "--out", str(tmp_path / f"{place}.json")]) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1, said
        assert str(tmp_path) in said
    assert names(tmp_path) == ["file", "loop"]


def test_a_fifo_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "metrics.jsonl")
    with pytest.raises(OSError, match=f"'{tmp_path}/metrics.jsonl'"):
        files.append_line(tmp_path / "metrics.jsonl", "{}")
