"""The house's own rules: few entries at the top, short files, few parameters, names without underscores."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from places import ROOT

MOST_ENTRIES, MOST_LINES, MOST_PARAMETERS = 22, 250, 6

MANY_PARAMETERS = {
    "InsertionVectorEnv.__init__": "the options of gymnasium.make_vec, each with a default",
    "Panel._text": "Pillow's own call: where, what, how large, in which ink",
    "textbook_cost": "an oracle: the formula's symbols, one by one",
}
"""Functions with more parameters than six, and why."""

FOLDERS = ("mjx_fit", "benchmarks", "experiments", "tests")
FILES = [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]


def functions(tree: ast.AST, inside: str = "") -> Iterator[tuple[str, ast.FunctionDef]]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef):
            yield inside + node.name, node
        yield from functions(node, f"{node.name}." if isinstance(node, ast.ClassDef) else inside)


def test_the_package_has_few_entries():
    entries = [path.name for path in (ROOT / "mjx_fit").iterdir() if path.name != "__pycache__"]
    assert len(entries) <= MOST_ENTRIES, entries


def test_files_are_short():
    long = {
        str(path): len(path.read_text(encoding="utf-8").splitlines())
        for path in FILES
        if "tests" not in path.parts
    }
    assert not {path: lines for path, lines in long.items() if lines > MOST_LINES}


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_parameters_are_few_and_imports_keep_their_names(path: Path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for name, function in functions(tree):
        given = function.args
        names = [one.arg for one in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
        count = len([one for one in names if one not in ("self", "cls")])
        count += (given.vararg is not None) + (given.kwarg is not None)
        assert count <= MOST_PARAMETERS or name in MANY_PARAMETERS, name
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            assert not [one.asname for one in node.names if one.asname and one.asname.endswith("_")]
