"""Nothing that is stored or shipped says where on a machine it was made."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import hostile_data
import numpy as np
import pytest
from hostile_results import right
from places import EARLIER_RUN, ROOT

from mjx_fit.evaluation import results
from mjx_fit.training import checkpoint

"""As an earlier version wrote it, paths and all."""
PLACES = rb"(?:\.\./)*/?(?:root|home/[a-z]|Users/[A-Za-z]|work/|tmp/|private/var)"
PATH = re.compile(rb"""(?:^|[\s"'=(])(""" + PLACES + rb"""[^\s"')]*)""")
MADE = {".json", ".jsonl", ".txt", ".yaml", ".h5", ".svg", ".ipynb", ".npz", ""}
"""Endings of files that programs make; people write of paths as they like."""


def committed() -> list[Path]:
    """What is committed; outside a repository, what the package holds."""
    told = subprocess.run(["git", "-C", str(ROOT), "ls-files", "-z"], capture_output=True, check=False)
    names = told.stdout.decode().split("\0")[:-1] if told.returncode == 0 else []
    paths = [ROOT / name for name in names] or [path for path in ROOT.rglob("mjx_fit/**/*") if path.is_file()]
    ours = {EARLIER_RUN, ROOT / "tests" / "mutations"}  # the second holds code, of which "root" is a word
    return [path for path in paths if path.is_file() and not ours & set(path.parents)]


def machine() -> list[bytes]:
    """Folders of this machine and user."""
    folders = {Path.cwd(), Path.home(), ROOT, Path(sys.prefix), Path(os.path.realpath(sys.prefix))}
    return sorted(str(folder).encode() for folder in folders if len(folder.parts) > 1)


def test_what_is_committed_names_no_place_of_a_machine():
    looked_at = [path for path in committed() if path.suffix in MADE]
    assert len(looked_at) > 50
    for path in looked_at:
        content = path.read_bytes()
        assert not PATH.findall(content), path
        assert not any(folder in content for folder in machine() if len(folder) > 5), path


def test_the_search_finds_what_it_looks_for():
    assert PATH.findall(b'successful to /root/.cache/run and "../../work/main/x.py" at /home/me')
    assert not PATH.findall(b"no/root here, shapes/home, homework")
    assert PATH.findall((EARLIER_RUN / checkpoint.BEST / "2" / "commit_success.txt").read_bytes())


@pytest.fixture
def made(tmp_path) -> Path:
    """A data set, a result and a checkpoint, as the commands make them."""
    (tmp_path / "made").mkdir()
    hostile_data.write(tmp_path / "made" / "data")
    checkpoint.save(tmp_path / "made" / "run" / checkpoint.LAST, 1, {"a": np.arange(30.0)})
    (tmp_path / "right.json").write_text(json.dumps(right("attempt")))
    result = results.read(tmp_path / "right.json")
    results.write(tmp_path / "made" / "result.json", replace(result, seed=3))
    return tmp_path / "made"


def test_what_is_made_names_no_place_of_this_machine(made, tmp_path):
    found = [path for path in made.rglob("*") if path.is_file()]
    assert len(found) > 6
    for path in found:
        content = path.read_bytes()
        for folder in (*machine(), str(tmp_path).encode()):
            assert folder not in content, path
