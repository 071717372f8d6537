"""Damaged entries of the compilation cache are made again."""

import os
import warnings
from pathlib import Path

import jax
import pytest

from mjx_fit.utils import compilation_cache


@pytest.fixture
def kept(monkeypatch):
    """Compiles a computation, as a new process would, and gives the file that is kept of it."""
    before = jax.config.jax_persistent_cache_min_compile_time_secs
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    folder = Path(jax.config.jax_compilation_cache_dir)

    def compile_it():
        def quite_its_own(x):
            return x * 3.0 + 0.125

        assert float(jax.jit(quite_its_own)(1.0)) == 3.125
        return next(folder.glob("jit_quite_its_own-*-cache"))

    yield compile_it
    jax.config.update("jax_persistent_cache_min_compile_time_secs", before)


def truncated(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def folder_in_its_place(path):
    path.unlink()
    path.mkdir()


DAMAGES = {
    "truncated": truncated,
    "empty": lambda path: path.write_bytes(b""),
    "of something else": lambda path: path.write_bytes(b"something else"),
    "a folder": folder_in_its_place,
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_entry_is_replaced_once(damage, kept, capsys):
    path = kept()
    DAMAGES[damage](path)
    with warnings.catch_warnings():
        compilation_cache.replace_damaged(path.parent)
        kept()
        assert capsys.readouterr().err.count("is damaged: compiling it again") == 1
        kept()
        assert capsys.readouterr().err == ""
    assert path.stat().st_size > 100


def test_other_warnings_are_shown_as_ever(tmp_path):
    shown = []
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = lambda message, *_: shown.append(str(message))
        compilation_cache.replace_damaged(tmp_path)
        warnings.warn("something else", stacklevel=1)
    assert shown == ["something else"]


def test_the_folder_is_made_or_done_without(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(compilation_cache, "CACHE", tmp_path / "cache")
    assert compilation_cache.folder(None) == tmp_path / "cache" / "xla"
    (tmp_path / "cache" / "xla").rmdir()
    (tmp_path / "cache" / "xla").write_text("a file where a folder was")
    assert compilation_cache.folder(None) == tmp_path / "cache" / "xla"
    assert compilation_cache.folder(str(tmp_path / "mine")) == tmp_path / "mine"
    assert compilation_cache.folder("gs://bucket/xla") is not None
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("asked", [None, "JAX_COMPILATION_CACHE_DIR"])
def test_a_folder_that_cannot_be_is_said_once(asked, tmp_path, monkeypatch, capsys):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(compilation_cache, "CACHE", tmp_path / "file")
    assert compilation_cache.folder(asked and str(tmp_path / "file" / "sub")) is None
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "compiled computations are not cached" in said
    assert (asked or "") in said


def test_without_a_home_nothing_is_made_in_the_working_folder(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(compilation_cache, "CACHE", Path("~/.cache/mjx_fit"))
    assert compilation_cache.folder(None) is None
    assert "no home folder" in capsys.readouterr().err
    assert os.listdir() == []
