"""Breaks the code in one place at a time and looks whether a test of that place fails.

    python tests/mutations/run.py [--out FILE] [--only WORD] [--limit SECONDS]

``mutations.txt`` has the places. Each mutation is made in a copy of the tree, where the test files about the
place run until one fails: the mutation is killed, if that test passes without it. What survives wants a test.
Run again, the command goes on where it stopped, and tries what survived once more. It is no part of the
suite: a mutation takes some seconds to some minutes.
"""

import argparse
import json
import multiprocessing
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload(
    [
        "jax",
        "mujoco.mjx",
        "flax.nnx",
        "optax",
        "orbax.checkpoint",
        "h5py",
        "scipy.stats",
        "hypothesis",
        "pytest",
    ]
)
LATE = "nothing ended within "


class Mutation(NamedTuple):
    """A change of one place.

    Attributes:
        file: The file, from the root.
        old: What stands there, once.
        new: What takes its place.
        tests: The test files about the place, or tests in them, the nearest first.
    """

    file: str
    old: str
    new: str
    tests: tuple[str, ...]


def read(text: str) -> list[Mutation]:
    """The mutations of a file like ``mutations.txt``."""
    found = []
    for block in f"\n{text}".split("\n@ ")[1:]:
        head, *lines = block.splitlines()
        file, tests = head.split(": ")
        old, new = ("\n".join(line[1:] for line in lines if line.startswith(sign)) for sign in "-+")
        parts = (name.partition("::") for name in tests.split())
        names = tuple(f"{path_of(name)}{colons}{test}" for name, colons, test in parts)
        found.append(Mutation(f"mjx_fit/{file}", old, new, names))
    return found


def path_of(name: str) -> str:
    """The test file of a name, from the root."""
    (path,) = (ROOT / "tests").rglob(f"test_{name}.py")
    return str(path.relative_to(ROOT))


def copy_tree(to: Path) -> None:
    """The working tree as git sees it, with one cache of compiled code for all runs."""
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listed, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    for name in filter(None, names.split("\0")):
        if (ROOT / name).is_file():
            (to / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, to / name)
    conftest = to / "tests" / "conftest.py"
    text = conftest.read_text()
    if "folder.name" not in text:
        sys.exit("tests/conftest.py no longer names its cache of compiled code: change run.py")
    conftest.write_text(text.replace("folder.name", repr(str(to / "compiled"))))


def failing(tree: Path, tests: tuple[str, ...], limit_s: float) -> str:
    """The first of these tests that fails in a tree, or "" where all pass."""
    report = tree / "report.txt"
    process = FORKS.Process(target=run_tests, args=(tree, tests, report))
    process.start()
    process.join(limit_s)
    if process.is_alive():
        process.kill()
        process.join()
        return f"{LATE}{limit_s:.0f} s"
    if process.exitcode == 0:
        return ""
    text = report.read_text()
    named = re.search(r"^(?:FAILED|ERROR) (.*?)(?: - |$)", text, re.MULTILINE)
    if not named:
        sys.exit(text)
    return named[1]


def run_tests(tree: Path, tests: tuple[str, ...], report: Path) -> None:
    """In a process of its own, which has what takes long to import, but nothing of the tree."""
    os.chdir(tree)
    os.environ |= {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    sys.path.insert(0, str(tree))
    sys.dont_write_bytecode = True
    with report.open("w") as file:
        for stream in (1, 2):
            os.dup2(file.fileno(), stream)
        import pytest

        sys.exit(pytest.main(["-x", "-p", "no:cacheprovider", "--tb=no", *tests]))


def tried(tree: Path, mutation: Mutation, limit_s: float) -> str:
    """What a mutation comes to: the test that kills it, or "" where it survives."""
    path = tree / mutation.file
    text = path.read_text()
    path.write_text(text.replace(mutation.old, mutation.new))
    try:
        return failing(tree, mutation.tests, limit_s)
    finally:
        path.write_text(text)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "runs" / "mutations.json", help="what was found")
    parser.add_argument("--only", default="", help="mutations whose file or text holds this word")
    parser.add_argument("--limit", type=float, default=300, help="seconds for the tests of one mutation")
    args = parser.parse_args()
    every = read((HERE / "mutations.txt").read_text())
    stale = [one for one in every if (ROOT / one.file).read_text().count(one.old) != 1]
    for one in stale:
        print(f"stale: {one.file} does not hold once: {one.old}")
    found = json.loads(args.out.read_text()) if args.out.exists() else {}
    todo = [one for one in every if args.only in "".join(one[:3]) and one not in stale]
    todo = [one for one in todo if not found.get(json.dumps(one))]
    args.out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="mutations-") as folder:
        tree = Path(folder)
        copy_tree(tree)
        sound = set()
        for one in todo:
            start = time.monotonic()
            killer = tried(tree, one, args.limit)
            if killer and not killer.startswith(LATE) and killer not in sound:
                if failing(tree, (killer,), args.limit):
                    sys.exit(f"{killer} fails without any mutation")
                sound.add(killer)
            found[json.dumps(one)] = killer
            args.out.write_text(json.dumps(found, indent=1))
            print(f"{killer or 'SURVIVED'}  ({time.monotonic() - start:.0f} s)", flush=True)
            print(f"    {one.file}: {one.old.strip()}  ->  {one.new.strip()}", flush=True)
    known = {json.dumps(one) for one in every}
    alive = [one for one, killer in found.items() if one in known and not killer]
    print(f"{len(every)} mutations, {len(alive)} survived, {len(stale)} stale")
    return bool(alive or stale)


if __name__ == "__main__":
    sys.exit(main())
