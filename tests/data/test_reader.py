"""Damage to a data set, and its manifest."""

import random
import shutil

import jax
import numpy as np
import pytest
from collecting import files_of
from hypothesis import given
from hypothesis import strategies as st

from mjx_fit.data import reader
from mjx_fit.data.manifest import manifest_text, parse_manifest
from mjx_fit.utils.errors import RequestError


@pytest.fixture(scope="module")
def folder(collect, tmp_path_factory):
    return collect(tmp_path_factory.mktemp("data") / "set", episodes=20)


@pytest.fixture(scope="module")
def text(folder):
    return (folder / "manifest.json").read_text()


def flip(rng, path, _):
    content = bytearray(path.read_bytes())
    content[rng.randrange(len(content))] ^= rng.randrange(1, 256)
    path.write_bytes(content)


def truncate(rng, path, _):
    path.write_bytes(path.read_bytes()[: rng.randrange(path.stat().st_size)])


def delete(_, path, __):
    path.unlink()


def swap(_, path, other):
    content = path.read_bytes()
    path.write_bytes(other.read_bytes())
    other.write_bytes(content)


def replace_by_foreign(rng, path, _):
    path.write_bytes(rng.randbytes(path.stat().st_size))


@pytest.mark.parametrize("count", [40, pytest.param(200, marks=pytest.mark.slow)])
def test_damages_are_all_found_and_what_is_healthy_stays_readable(folder, tmp_path, count):
    rng = random.Random(0)
    whole = reader.load(folder)
    names = sorted(path.name for path in folder.glob("*.h5"))
    kinds = (flip, truncate, delete, swap, replace_by_foreign)
    for i in range(count):
        out = tmp_path / f"{i}"
        shutil.copytree(folder, out)
        kind = kinds[i % len(kinds)]
        name, other = rng.sample(names, 2)
        kind(rng, out / name, out / other)
        hurt = {name, other} if kind is swap else {name}
        found = reader.damages(out)
        assert set(found) == hurt, kind
        with pytest.raises(RequestError, match="damaged or missing"):
            reader.load(out)
        healthy = reader.load(out, without=found)
        rows = healthy.episode
        assert len(rows) == 20 - 5 * len(hurt)
        expected = jax.tree.map(lambda leaf, rows=rows: leaf[rows], whole)
        for a, b in zip(jax.tree.leaves(healthy), jax.tree.leaves(expected), strict=True):
            assert np.array_equal(a, b)
        shutil.rmtree(out)


@pytest.mark.parametrize("kind", [flip, truncate, delete, swap, replace_by_foreign])
def test_what_is_damaged_is_named_and_made_anew_and_nothing_else(kind, folder, collect, tmp_path):
    out = tmp_path / "damaged"
    shutil.copytree(folder, out)
    names = ["shard-00000005.h5", "shard-00000015.h5"]
    kind(random.Random(1), *(out / name for name in names))
    said = reader.damages(out)
    words = {
        truncate: "bytes instead of",
        delete: "missing",
        swap: "holds the content of shard-00000015",
    }
    assert words.get(kind, "SHA-256") in said["shard-00000005.h5"]
    stamps = {path: path.stat().st_mtime_ns for path in out.iterdir() if path.name not in said}
    collect(out, episodes=20)
    assert files_of(out) == files_of(folder)
    assert stamps == {path: path.stat().st_mtime_ns for path in out.iterdir() if path.name not in said}


def test_a_shard_too_many_is_named(folder, tmp_path):
    out = tmp_path / "more"
    shutil.copytree(folder, out)
    shutil.copy(out / "shard-00000005.h5", out / "shard-00000099.h5")
    assert reader.damages(out) == {"shard-00000099.h5": "foreign: the manifest does not list it; remove it"}


@given(place=st.integers(0, 10**6), bits=st.integers(1, 255))
def test_any_changed_byte_of_the_manifest_is_noticed(text, place, bits):
    content = bytearray(text.encode())
    content[place % len(content)] ^= bits
    with pytest.raises(ValueError):  # noqa: PT011  (UnicodeDecodeError and FormatError are among them)
        parse_manifest(content.decode())


def test_a_shortened_manifest_is_noticed(text):
    for length in range(0, len(text), 97):
        with pytest.raises(ValueError):  # noqa: PT011
            parse_manifest(text[:length])
    assert manifest_text(parse_manifest(text)) == text


def test_missing_or_damaged_data_is_one_line(folder, tmp_path):
    with pytest.raises(RequestError, match="there is no such folder"):
        reader.load(tmp_path / "nowhere")
    for read in (reader.load, reader.damages):
        with pytest.raises(RequestError, match="it is not a data set"):
            read(tmp_path)
    shutil.copy(folder / "shard-00000005.h5", tmp_path)
    assert "missing" in reader.damages(tmp_path)["manifest.json"]
    (tmp_path / "manifest.json").write_text("{")
    with pytest.raises(RequestError, match=r"manifest\.json is damaged"):
        reader.load(tmp_path)
    assert "damaged" in reader.damages(tmp_path)["manifest.json"]
    (tmp_path / "manifest.json").write_text('{"format": 1}')
    for read in (reader.load, reader.damages):
        with pytest.raises(RequestError, match="its format is 1, not one of 2, 3"):
            read(tmp_path)
