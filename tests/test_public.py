"""The public face: what it names, what it loads, and that the example of every name runs."""

import ast
import doctest
import importlib
import re
import subprocess
import sys

import pytest
from places import ROOT

import mjx_fit as mf

BEFORE_JAX = "import mjx_fit, sys; sys.exit(bool({'jax', 'mujoco', 'numpy'} & set(sys.modules)))"


def test_importing_it_loads_neither_jax_nor_mujoco():
    assert subprocess.run([sys.executable, "-c", BEFORE_JAX], check=False).returncode == 0


def test_it_has_about_25_names_that_the_stub_has_too():
    assert 20 <= len(mf.__all__) <= 30
    stub = ast.parse((ROOT / "mjx_fit" / "__init__.pyi").read_text())
    imported = {
        (name.asname or name.name).removeprefix("_"): (one.module, name.name)
        for one in stub.body
        if isinstance(one, ast.ImportFrom)
        for name in one.names
    }
    assert imported == mf._PUBLIC
    assert sorted(dir(mf)) == sorted([*mf.__all__, "__version__"])
    assert mf.__doc__ is not None
    assert re.findall(r"`(\w+)`", mf.__doc__.replace("``", "")) == list(mf.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = mf.nothing  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize("name", mf.__all__)
def test_the_example_of_every_name_runs(name, monkeypatch, tmp_path):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    module, attribute = mf._PUBLIC[name]
    value = getattr(importlib.import_module(module), attribute)
    if name == "configure":
        monkeypatch.setattr(mf, "configure", lambda: None, raising=False)  # it would hold for all tests
    example = doctest.DocTestParser().get_doctest(value.__doc__ or "", {}, name, None, None)
    assert example.examples, f"{name} has no example"
    said: list[str] = []
    doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(example, out=said.append)
    assert not said, "".join(said)


def test_the_readmes_python_runs():
    text = (ROOT / "README.md").read_text()
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert blocks
    for block in blocks:
        exec(compile(block, "README.md", "exec"), {})


def test_own_examples_import_the_public_face_alone():
    for path in (ROOT / "experiments" / "own").glob("*.py"):
        text = path.read_text()
        assert len(text.splitlines()) < 60, path.name
        used = re.findall(r"^(?:import|from) (mjx_fit\S*)(.*)$", text, re.MULTILINE)
        assert used == [("mjx_fit", " as mf")], path.name
