"""The list of mutations stays true: each names a place that is there, once, and its tests."""

import importlib.util
from pathlib import Path

import pytest

HERE = Path(__file__).parent
ROOT = HERE.parents[1]


def _listed():
    spec = importlib.util.spec_from_file_location("mutations_run", HERE / "run.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.read((HERE / "mutations.txt").read_text(encoding="utf-8"))


LISTED = _listed()


@pytest.mark.parametrize("mutation", LISTED, ids=lambda one: f"{one.file}: {one.old[:40]}")
def test_the_place_is_there_once(mutation):
    assert (ROOT / mutation.file).read_text(encoding="utf-8").count(mutation.old) == 1
