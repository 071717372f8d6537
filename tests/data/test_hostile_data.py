"""Shards and manifests whose digests are right and whose content is not: one line each, nothing left."""

import copy
import io
import json
import random
import shutil
from pathlib import Path
from typing import Any

import h5py
import hostile_data as hostile
import numpy as np
import pytest
from places import EXPERIMENTS

from mjx_fit.cli import main
from mjx_fit.data import manifest, reader
from mjx_fit.data.manifest import manifest_text, parse_manifest
from mjx_fit.data.merge import merge
from mjx_fit.utils.errors import RequestError


def said(capsys, *command: object) -> tuple[int, list[str], list[str]]:
    capsys.readouterr()
    code = main.main([str(word) for word in command])
    out, err = capsys.readouterr()
    return code, out.splitlines(), err.splitlines()


def readers(folder: Path, out: Path) -> dict[str, list[object]]:
    """Every command that reads a data set."""
    return {
        "info": ["data", "info", folder],
        "report": ["report", folder, "--out", out / "page"],
        "npz": ["data", "export", folder, "--out", out / "set.npz"],
        "hdf5": ["data", "export", folder, "--out", out / "set.hdf5"],
        "train": ["train", "--data", folder, "--out", out / "run"],
        "merge": ["data", "merge", folder, "--out", out / "merged"],
    }


def assert_refused(capsys, folder: Path, out: Path, named: str) -> None:
    """By every reader in one line that names the file; nothing is left behind but a folder without shards."""
    for command in readers(folder, out).values():
        code, _, err = said(capsys, *command)
        assert code == 2, command
        assert len(err) == 1, command
        assert named in err[0], command
        assert len(err[0]) < 600
    left = [path for path in out.rglob("*") if path.is_file() and path.name not in (".lock", "manifest.json")]
    assert left == []


def test_the_data_set_that_is_changed_below_is_right(tmp_path, capsys):
    folder = hostile.write(tmp_path / "set")
    assert said(capsys, "data", "check", folder)[0] == 0
    for name, command in readers(folder, tmp_path).items():
        if name != "train":  # with so few episodes nothing is left to validate on
            assert said(capsys, *command)[0] == 0
    assert reader.load(folder).episode.tolist() == list(range(hostile.EPISODES))
    assert said(capsys, "data", "info", hostile.write(tmp_path / "told", hostile.attribute))[0] == 0


@pytest.mark.parametrize("name", hostile.SHARDS)
def test_a_shard_that_is_none_is_one_line(name, tmp_path, capsys):
    folder = hostile.write(tmp_path / "set", hostile.SHARDS[name])
    code, out, _ = said(capsys, "data", "check", folder)
    assert code == 1
    assert len(out) == 1
    assert out[0].startswith(f"{hostile.NAME}: damaged: ")
    assert_refused(capsys, folder, tmp_path / "out", hostile.NAME)


@pytest.mark.parametrize("make", [hostile.external, hostile.virtual])
def test_no_other_file_is_read(make, tmp_path, capsys):
    secret = tmp_path / "secret"
    secret.write_bytes(hostile.SECRET)
    if make is hostile.virtual:
        with h5py.File(secret, "w") as file:
            file["secret"] = np.full((hostile.EPISODES, 7), 42.0, np.float32)
    folder = hostile.write(tmp_path / "set", make(secret))
    assert "end_qpos: external and virtual data are not supported" in reader.damages(folder)[hostile.NAME]
    assert_refused(capsys, folder, tmp_path / "out", hostile.NAME)


@pytest.mark.parametrize("content", [b"", b"\x89HDF\r\n\x1a\n", b"text" * 100])
def test_what_is_no_hdf5_is_one_line(content, tmp_path, capsys):
    folder = hostile.write_content(tmp_path / "set", content or b"\0")
    assert_refused(capsys, folder, tmp_path / "out", hostile.NAME)


def test_a_hundred_shards_with_broken_bytes_are_one_line_each(tmp_path):
    """Bytes of HDF5's own bookkeeping among them: its library may refuse, and must not end the process."""
    content = (hostile.write(tmp_path / "set") / hostile.NAME).read_bytes()
    rng, said = random.Random(4), []
    for i in range(100):
        damaged = bytearray(content)
        for _ in range(rng.choice([1, 4, 64])):
            damaged[rng.randrange(len(damaged) if i % 2 else 4096)] ^= rng.randrange(1, 256)
        folder = hostile.write_content(tmp_path / f"{i}", bytes(damaged))
        try:
            reader.load(folder)  # a bit of an attribute, or of a number that may be any
        except RequestError as error:
            said.append(str(error))
        shutil.rmtree(folder)
    assert len(said) > 20
    assert all(hostile.NAME in words and "\n" not in words for words in said)


def test_a_shard_of_another_size_or_kind_is_not_read(tmp_path, capsys):
    folder = hostile.write(tmp_path / "set", bytes=2**40)
    assert_refused(capsys, folder, tmp_path / "out", hostile.NAME)
    pipe = hostile.write(tmp_path / "pipe")
    (pipe / hostile.NAME).unlink()
    (pipe / hostile.NAME).symlink_to("/dev/zero")
    assert_refused(capsys, pipe, tmp_path / "out", hostile.NAME)


def test_a_bomb_is_not_unpacked(tmp_path):
    """Zeros of a hundred times the request's size, packed as well as can be."""
    buffer = io.BytesIO((hostile.write(tmp_path / "set") / hostile.NAME).read_bytes())
    with h5py.File(buffer, "r+") as file:
        hostile.put("trace/contact", np.zeros((6, 4_000_000), bool), compression="gzip")(file)
    folder = hostile.write_content(tmp_path / "bomb", buffer.getvalue())
    with pytest.raises(RequestError, match="its shape is"):
        reader.load(folder)


def place(tree: Any, path: tuple) -> Any:
    for part in path:
        tree = tree[part]
    return tree


def signed(tree: dict[str, Any]) -> str:
    """A manifest's text with a digest that fits."""
    tree = {key: value for key, value in tree.items() if key != "sha256"}
    return json.dumps(tree | {"sha256": manifest._digest(tree)}, indent=1) + "\n"


DELETED = object()
ARABIC_ZERO = "\u0660"
SHARD = ("shards", 0)
MANIFESTS: list[tuple[tuple, Any]] = [
    *[((*SHARD, "name"), name) for name in (
        7, None, "", "profile", "../../profile", "/etc/profile", "shard-00000000.h5/../x", "shard-1.h5",
        "shard-00000000.h5\n", "shard-00000001.h5", f"shard-{8 * ARABIC_ZERO}.h5", "Shard-00000000.h5",
        "x" * 100_000, "shard-\x1b[2J.h5", ["shard-00000000.h5"],
    )],
    *[((*SHARD, "episodes"), n) for n in ("4", 0, -1, 7, 10**12, 6.0, True, None, [])],
    *[((*SHARD, "first_episode"), n) for n in ("0", -1, 1, 0.0)],
    *[((*SHARD, "bytes"), n) for n in (-1, "1", 2**60, 1.5, 0)],
    *[((*SHARD, "sha256"), digest) for digest in ("", "0" * 63, "G" * 64, 0, None)],
    *[((*SHARD, "device"), device) for device in (0, None, "cpu\x1b[2J", "x" * 10_000)],
    *[((*SHARD, key), DELETED) for key in ("name", "episodes", "device")],
    ((*SHARD, "more"), 1),
    *[(("shapes",), value) for value in ([], ["a", "b"], [1, 2, 3], ["a"] * 3, "abc", None, ["A", "b", "c"])],
    *[(("part",), value) for value in ([], [0], [1, 1], [-1, 1], [0, 0], [0, 1, 2], ["0", "1"], "01", {})],
    *[(("request", "episodes"), n) for n in ("4", 0, -6, 10**9, 6.5, None, [6])],
    *[(("request", "steps"), n) for n in ("4", 0, 10**6, 4.0, True)],
    *[(("request", "policy"), word) for word in ("", "../x", "a b", 0, None, ["random"])],
    *[(("request", "seed"), n) for n in (-1, 2**32, "0", 0.5)],
    *[(("request", "batch"), n) for n in (0, 10**6, 3, "250")],
    *[(("request", "sequence"), n) for n in (0, 4, 31, "1")],
    *[(("request", "engine"), word) for word in ("auto", "", 3, "bullet")],
    *[(("request", "config"), value) for value in ({"scene": 3}, [], None, "x", 4)],
    *[(("request", key), DELETED) for key in ("config", "policy", "engine", "steps")],
    (("request", "more"), {}),
    (("request",), []),
    *[(("versions",), value) for value in ([], {"jax": 1}, {"jax": None}, {"j\na": "1"}, None)],
    *[(("complete",), value) for value in ("true", 1, None)],
    *[(("shards",), value) for value in ({}, None, [[]], [None], "x", [])],
    *[(("format",), value) for value in (5, 1, "3", None, [3], 2.5, 10**18)],
    (("more",), 1),
    *[((key,), DELETED) for key in ("request", "part", "versions", "shapes", "complete", "shards", "format")],
]  # fmt: skip


@pytest.mark.parametrize("where", sorted({path[0] for path, _ in MANIFESTS}))
def test_a_manifest_that_is_none_is_one_line(where, tmp_path, capsys):
    folder = hostile.write(tmp_path / "set")
    right = json.loads((folder / "manifest.json").read_text())
    for path, value in (one for one in MANIFESTS if one[0][0] == where):
        tree = copy.deepcopy(right)
        if value is DELETED:
            del place(tree, path[:-1])[path[-1]]
        else:
            place(tree, path[:-1])[path[-1]] = value
        (folder / "manifest.json").write_text(signed(tree))
        with pytest.raises(ValueError):  # noqa: PT011  (FormatError is among them)
            parse_manifest(signed(tree))
        assert said(capsys, "data", "check", folder)[0] in (1, 2), (path, value)
        commands = readers(folder, tmp_path / "out")
        for name in ("info", "train") if value != "../../profile" else commands:
            code, _, err = said(capsys, *commands[name])
            assert code == 2, (path, value)
            assert len(err) == 1, (path, value)
            assert str(folder) in err[0]
            assert err[0].isprintable()
            assert len(err[0]) < 600
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000,
        '{"format": 2, "request": ' + '{"a": ' * 900 + "1" + "}" * 901,
        '{"format": ' + "2" * 5000 + "}",
        '{"format": 2, "format": 2}',
        '{"format": NaN}',
        '{"format": "\\ud800"}',
        '"text"',
        "3",
        "null",
        "\ufeff{}",
    ],
)
def test_json_that_is_hostile_is_one_line(text, tmp_path, capsys):
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "manifest.json").write_text(text)
    for command in (*readers(tmp_path / "set", tmp_path / "out").values(),):
        code, _, err = said(capsys, *command)
        assert code == 2
        assert len(err) == 1
        assert len(err[0]) < 600
    assert said(capsys, "data", "check", tmp_path / "set")[0] == 1


def test_what_is_right_is_read_byte_for_byte(tmp_path):
    for text in (
        manifest_text(hostile.manifest()),
        (EXPERIMENTS / "data" / "sample" / "manifest.json").read_text(),
    ):
        assert manifest_text(parse_manifest(text)) == text


def test_merging_writes_nowhere_else(tmp_path):
    """A part whose shard is called ``../../profile``, as the issue has it."""
    part = hostile.write(tmp_path / "deep" / "part") if (tmp_path / "deep").mkdir() is None else None
    assert part is not None
    tree = json.loads((part / "manifest.json").read_text())
    tree["shards"][0]["name"] = "../../profile"
    (part / "manifest.json").write_text(signed(tree))
    shutil.copy(part / hostile.NAME, tmp_path / "profile.source")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(RequestError, match=r"shards\.0\.name"):
        merge([part], tmp_path / "deep" / "out")
    assert sorted(tmp_path.rglob("*")) == before
