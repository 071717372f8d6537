"""The folder of a training run: config.yaml, run.json, metrics.jsonl, checkpoints.

One folder is one run: the same configuration but for the number of epochs, the same seed and the same data.
"""

import inspect
import json
import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np
from jaxtyping import Int

from mjx_fit.config.files import read_stored_config
from mjx_fit.config.schema import Config, config_differences, config_to_yaml
from mjx_fit.training import run_files
from mjx_fit.training.run_files import CONFIG, METRICS, RUN
from mjx_fit.utils import files, locks, provenance
from mjx_fit.utils.errors import RequestError, require
from mjx_fit.utils.filesystem import path_inside, refuse_link

P = ParamSpec("P")
R = TypeVar("R")

MAX_MEMBERS = 100
_ENTRIES = (CONFIG, RUN, METRICS, "checkpoints", "checkpoints/best", "checkpoints/last")
"""What is written to in the folder: none may be a link."""


@dataclass(frozen=True)
class Run:
    """A training run.

    Attributes:
        out: Its folder.
        seed: Root of weights, split, windows and noise.
        members: Number of sensors, an ensemble if more than one; each has a folder ``member-M`` of its own.
        init: Folder of another run, whose best sensor this one starts from; None: new weights.
        inside: Folder inside that of the run, or inside those of its members, where this training goes.
    """

    out: Path
    seed: int
    members: int = 1
    init: Path | None = None
    inside: str = ""

    def folders(self) -> list[Path]:
        """The folder of each member.

        Raises:
            RequestError: As ``members``.
        """
        return members(self.out, self.members, self.inside)


@dataclass(frozen=True)
class Lineage:
    """What a sensor was made from.

    Attributes:
        seed: Root seed.
        data: Fingerprint of the data.
        origin: Of the sensor that the training starts from, if it is a trained one.
    """

    seed: int
    data: str
    origin: dict[str, Any] | None = None


def identity(config: Config) -> Config:
    """The part of the configuration that makes it this run.

    A run may be continued to more epochs, unless its learning rate was to reach zero with the last, and with
    more patience.
    """
    epochs = config.train.epochs if config.train.schedule == "cosine" else 1
    return replace(config, train=replace(config.train, epochs=epochs, patience=0))


def require_members(count: int) -> None:
    """Refuse a number of sensors that is none, or more than are trained at once.

    Raises:
        RequestError: It is invalid.
    """
    require("--members", count, 1, MAX_MEMBERS)


def members(out: Path, count: int, inside: str = "") -> list[Path]:
    """The folders of the runs of an ensemble; of one alone, its own.

    Raises:
        RequestError: There may not be so many, or the folder holds what is no part of so many.
    """
    require_members(count)
    if count == 1:
        return [_below(out, inside)]
    names = [f"member-{member}" for member in range(count)]
    foreign = files.foreign(out, {"checkpoints", "frame_by_frame", *names})
    if foreign:
        raise RequestError(
            f"--out: {out} cannot be used: it holds other files ({foreign[0]}); choose a new folder"
        )
    return [_below(path_inside(out, name), inside) for name in names]


def _below(out: Path, inside: str) -> Path:
    return path_inside(out, inside) if inside else out


def held(train: Callable[P, R]) -> Callable[P, R]:
    """Hold the folder of a run, and those in it that are trained into, while a function trains there.

    Args:
        train: Has a parameter ``run``.

    Returns:
        The same function. It raises a RequestError where another process trains in one of the folders, and a
        WorkError where one is taken away.
    """
    signature = inspect.signature(train)

    @wraps(train)
    def trains(*args: P.args, **kwargs: P.kwargs) -> R:
        run = signature.bind(*args, **kwargs).arguments["run"]
        folders = [run.out, *run.folders()]
        with ExitStack() as stack:
            for folder in dict.fromkeys(folders):
                # What is finished may be read-only.
                stack.enter_context(locks.holding(folder, even_if_read_only=True))
            return train(*args, **kwargs)

    return trains


def check(out: Path, config: Config, lineage: Lineage) -> None:
    """Make sure that the folder is new or holds this very run; write nothing.

    Args:
        out: The folder.
        config: The configuration.
        lineage: What its sensor is made from.

    Raises:
        RequestError: It is not a folder, or it holds another run or other files.
    """
    if out.exists() and not out.is_dir():
        raise RequestError(f"--out: {out} is invalid: expected a folder")
    for name in _ENTRIES:
        refuse_link(out / name)
    if not (out / RUN).is_file():
        _require_free(out, config)
        return
    there = run_files.read(out, needed=("seed", "data"))
    differences = [
        f"{name} is {there[name]} there and {here} here"
        for name, here in (("seed", lineage.seed), ("data", lineage.data))
        if there[name] != here
    ]
    _require_origin(out, there.get("init"), lineage.origin)
    before = read_stored_config(out / CONFIG)
    differences += config_differences(*map(identity, (before, config)))
    _require_end(out, before, config, differences)
    if differences:
        raise RequestError(
            f"--out: {out} cannot be used: it holds another run ({differences[0]}); choose a new folder"
        )


def require_same_arithmetic(out: Path) -> None:
    """Make sure that a begun run is continued with the settings of the process that it was begun with.

    Other versions of the libraries are only warned about.

    Raises:
        RequestError: A setting such as ``XLA_FLAGS``, which changes arithmetic, differs.
    """
    if not (out / RUN).is_file():
        return
    there, here = run_files.read(out).get("versions", {}), provenance.versions()
    for name, old, new in provenance.differing(*map(provenance.settings_of, (there, here))):
        raise RequestError(
            f"{name}: {new} cannot be used here: {out} was begun with {old}, and its numbers depend on it"
        )
    for name, old, new in provenance.differing(there, here)[:1]:
        print(
            f"mjx-fit: {out} was begun with {name} {old}, and goes on with {new}: last digits may differ",
            file=sys.stderr,
        )


def write(
    out: Path,
    config: Config,
    lineage: Lineage,
    first_hole: dict[str, Any],
    sequences: Int[np.ndarray, "episodes"],
    sides: tuple[Int[np.ndarray, "n"], Int[np.ndarray, "m"]],
) -> None:
    """Write down what the run is; ``run.json`` last, and only once.

    Args:
        out: The folder.
        config: The configuration.
        lineage: What its sensor is made from.
        first_hole: Of the data, by which others at the same holes are known.
        sequences: Which sequence, that is which hole, each episode belongs to.
        sides: Indices of the training and of the validation episodes.
    """
    files.write_text(out / CONFIG, config_to_yaml(config))
    if not (out / RUN).is_file():
        run = {
            "seed": lineage.seed,
            "data": lineage.data,
            "first_hole": first_hole,
            **{
                side: {"interactions": len(ids), "holes": len(np.unique(np.asarray(sequences)[ids]))}
                for side, ids in zip(("training", "validation"), sides, strict=True)
            },
            "versions": provenance.versions(),
            "device": provenance.device(),
            **({} if lineage.origin is None else {"init": lineage.origin}),
        }
        files.write_text(out / RUN, json.dumps(run, indent=2) + "\n")


def _require_origin(out: Path, there: dict[str, Any] | None, here: dict[str, Any] | None) -> None:
    """Refuse to continue a run from other weights than it started from."""
    if (there or {}).get("sensor") == (here or {}).get("sensor"):
        return
    started = "new weights" if there is None else "a trained sensor"
    how = "leave --init away" if there is None else "give the --init that it was begun with"
    raise RequestError(
        f"--init: {'none' if here is None else 'this one'} cannot be used: {out} started from {started}"
        f"{' that is not this one' if there and here else ''}; {how}, or choose a new folder"
    )


def _require_end(out: Path, before: Config, now: Config, differences: list[str]) -> None:
    """Refuse to move the end of a run where it cannot be moved."""
    cosine = [words for words in differences if words.startswith("train.epochs ")]
    if cosine and cosine == differences:
        raise RequestError(
            f"--epochs: {now.train.epochs} cannot be used: {cosine[0]}, where train.schedule cosine brings "
            f"the learning rate to zero; start another run from this one: --init {out} --out NEW"
        )
    there, here = before.train.patience, now.train.patience
    if not differences and here and (not there or here < there):
        raise RequestError(
            f"config: train.patience: {here} cannot be used: {out} has {there or '0 (never stop early)'}, "
            "which may only grow"
        )


def _require_free(out: Path, config: Config) -> None:
    """A folder without a run may hold what a killed start of this very run left behind, and nothing else."""
    begun = {CONFIG: config_to_yaml(config)}
    for name in files.foreign(out, {RUN}):
        path = out / name
        torn = files.is_temporary(name, of={CONFIG})
        if not torn and not (
            path.is_file() and path.read_bytes().decode(errors="replace") == begun.get(name)
        ):
            raise RequestError(
                f"--out: {out} cannot be used: it holds other files ({name}); choose a new folder"
            )
