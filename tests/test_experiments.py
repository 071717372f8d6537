"""Scripts of experiments can be imported: the names that they use exist in the library."""

import importlib.util
import sys

import pytest
from places import EXPERIMENTS

SCRIPTS = [path for path in sorted(EXPERIMENTS.rglob("*.py")) if path.name != "online.py"]
"""Without the one that has no main function: ``test_tracker`` runs it."""


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: str(path.relative_to(EXPERIMENTS)))
def test_a_script_finds_what_it_imports(path, monkeypatch):
    monkeypatch.setattr(sys, "path", [str(path.parent), *sys.path])
    monkeypatch.delitem(sys.modules, "shared", raising=False)
    spec = importlib.util.spec_from_file_location(f"script_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except ModuleNotFoundError as missing:
        if str(missing.name).startswith(("mjx_fit", "benchmarks", "shared")):
            raise
        pytest.skip(f"{missing.name} is not installed")
    finally:
        sys.modules.pop("shared", None)
