"""Checkpoints of an experiment: each part is stored next to the result file until all are complete."""

import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Int

from mjx_fit.config.schema import Config
from mjx_fit.engines.threads import even_batch
from mjx_fit.evaluation.result_file import Header
from mjx_fit.jobs.pool import Pool, Tell
from mjx_fit.utils import bounded_json, files, locks, provenance
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.filesystem import path_inside

Rows = list[dict[str, Any]]
ASKED = "request.json"
LARGEST = 2**30
"""Largest part, in bytes."""
ROWS, ROWS_ON_ACCELERATOR = 1024, 16384
"""Most rows per part: enough to fill the engine, and one or two minutes of work."""
ROWS_BY_GEOMETRY = 64
"""The same where particles are conditioned on each attempt, one after the other, for a second or more."""


def pieces(
    n: int, rows_each: int, engine: str, config: Config, asked: int | None = None
) -> list[Int[np.ndarray, "m"]]:
    """Return the ids of n trials in parts of equal size; the last is padded with ids beyond n.

    Equal sizes matter: arithmetic may differ in the last bit between array shapes, and each shape is compiled
    separately.

    Args:
        n: Number of trials.
        rows_each: Rows per trial.
        engine: Name of the resolved engine.
        config: Tells what reads attempts.
        asked: Most rows of a part, if somebody asks for a number.
    """
    on_cpu = engine == "native" or jax.default_backend() == "cpu"
    rows = ROWS if on_cpu else ROWS_ON_ACCELERATOR
    if on_cpu and config.filter.reads == "geometry":
        rows = ROWS_BY_GEOMETRY
    rows = rows if asked is None else asked
    size = even_batch(n, max(1, rows // rows_each))
    return [np.arange(start, start + size) for start in range(0, n, size)]


def kept(out: Path) -> int:
    """Return the number of stored parts."""
    return len(list(_folder(out).glob("part-*.json")))


def in_parts(
    out: Path,
    here: Header,
    pieces: Sequence[Any],
    work: Callable[[Any, Tell], Rows],
    told: Callable[[Rows, int, str], None],
    pool: Pool,
) -> Rows:
    """Return the rows of all parts in order: stored parts are read, the others computed and stored.

    Parts are stored in a folder named like the result file, with suffix ``.parts``; ``finish`` removes it.

    Args:
        out: Result file.
        here: Header of the result: everything the rows depend on.
        pieces: Arguments of ``work``, one per part.
        work: Function that computes the rows of a part (``Pool.run``).
        told: Callback that receives all rows so far, and the units done and a text within a part.
        pool: Performs the parts.

    Raises:
        RequestError: The folder holds parts of another request.
        WorkError: As in ``Pool.run``.
    """
    folder = _folder(out)
    own = here | {"versions": provenance.versions(), "device": provenance.device()}
    _require_own(folder, own)
    paths = {f"part {n}": path_inside(folder, f"part-{n:05d}.json") for n in range(len(pieces))}
    stored = {name: _read(path) for name, path in paths.items()}
    missing = {
        name: piece for (name, made), piece in zip(stored.items(), pieces, strict=True) if made is None
    }
    rows = _in_order(stored)
    if len(missing) < len(pieces):
        told(rows, 0, "")

    def within(done: int, text: str) -> None:
        told(rows, done, text)

    for name, made in pool.run(work, missing, within):
        if not (folder / ASKED).is_file():  # only now: a refused request leaves no files
            files.write_text(folder / ASKED, json.dumps(own))
        files.write_text(paths[name], json.dumps(made))
        stored[name] = made
        rows = _in_order(stored)
        told(rows, 0, "")
    return rows


def _in_order(stored: dict[str, Rows | None]) -> Rows:
    """Return the rows of the parts that are there, in the order of the parts."""
    return [row for made in stored.values() for row in made or ()]


def finish(out: Path) -> None:
    """Remove the parts of a written result."""
    folder = _folder(out)
    if folder.is_dir():
        with locks.holding_file(out):
            for name in sorted(os.listdir(folder), key=lambda name: name == ASKED):
                (folder / name).unlink()
            folder.rmdir()


def _folder(out: Path) -> Path:
    return path_inside(out.parent, out.with_suffix(".parts").name)


def _read(path: Path) -> Any:
    """Read a stored part; None if missing or damaged, in which case it is recomputed."""
    try:
        return bounded_json.read(path, LARGEST)
    except (FileNotFoundError, ValueError):
        return None


def _require_own(folder: Path, asked: dict[str, Any]) -> None:
    path = path_inside(folder, ASKED)
    if path.is_file():
        there = _read(path)
        if there != asked:
            known = there if isinstance(there, dict) else {}
            names = [key for key in sorted(asked | known) if known.get(key) != asked.get(key)]
            name = names[0] if names else "contents"
            if name == "versions":
                name = provenance.differing(known.get(name, {}), asked[name])[0][0]
            raise RequestError(
                f"--out: {folder} cannot be used: it holds the unfinished work of another request "
                f"(its {name} differs); remove it or choose another file"
            )
    elif foreign := files.foreign(folder, {ASKED}):
        raise RequestError(f"--out: {folder} cannot be used: it holds other files ({foreign[0]}); remove it")
