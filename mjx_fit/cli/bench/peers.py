"""Peers: implementations for comparison with the library, in ``benchmarks/`` of a checkout."""

from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

_FOLDER = Path(__file__).parents[3] / "benchmarks"
_NEEDS = {"python_loop": "", "torch_twin": "torch"}
"""Package that each peer requires."""


def absence(name: str) -> str | None:
    """Return the reason why a peer cannot be measured; None if it can."""
    if not (_FOLDER / f"{name}.py").is_file():
        return f"benchmarks/{name}.py comes with a checkout only"
    if _NEEDS[name] and find_spec(_NEEDS[name]) is None:
        return f"{_NEEDS[name]} is not installed (pip install -e '.[bench]')"
    return None


def load_peer(name: str) -> ModuleType:
    """Load the module of an available peer."""
    spec = spec_from_file_location(f"benchmarks.{name}", _FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
