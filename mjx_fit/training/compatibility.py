"""Whether a sensor may be judged on a data set: not on holes that it was trained on, nor in another world."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, NotRequired

import numpy as np
from pydantic import Field, TypeAdapter
from typing_extensions import TypedDict

from mjx_fit.config.schema import Config, config_differences, config_from_tree
from mjx_fit.data.episode import Episode
from mjx_fit.training import run_files
from mjx_fit.training.run_files import RUN
from mjx_fit.utils import bounded_json
from mjx_fit.utils.errors import RequestError

_Metres = Annotated[float, Field(ge=-10, le=10, allow_inf_nan=False)]


class _Hole(TypedDict):
    sequence: int
    pos_world: Annotated[list[_Metres], Field(min_length=2, max_length=2)]


class _Told(TypedDict):
    """What a run says of its data; earlier ones did not name a hole."""

    seed: NotRequired[int]
    data: NotRequired[str]
    first_hole: NotRequired[_Hole | None]
    init: NotRequired["_Told"]


_TOLD = TypeAdapter(_Told)

WORLD = ("scene", "control")
"""Sections of the configuration that what is felt in a data set depends on, whatever was done there."""


def first_hole(data: Episode) -> dict[str, Any]:
    """The hole of the first sequence, which tells the seed: draws depend on it and on the number alone."""
    row = int(np.argmin(np.asarray(data.sequence)))
    position = np.asarray(data.rollout.truth.hole_pos_world)[row]
    return {"sequence": int(data.sequence[row]), "pos_world": [round(float(x), 7) for x in position]}


def told_by(run: Path) -> dict[str, Any]:
    """What a run folder remembers of what it was trained on, and of the sensor that it started from.

    Raises:
        RequestError: Its ``run.json`` is damaged.
    """
    if not (run / RUN).is_file():
        return {}
    told = run_files.read(run, option="--run")
    try:
        bounded_json.check(_TOLD, told)
    except ValueError as error:
        raise run_files.damaged(run / RUN, error, "--run") from None
    return {key: told[key] for key in ("seed", "data", "first_hole", "init") if key in told}


def lineage(told: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """What a run was trained on, what the sensor that it started from was trained on, and so on."""
    while told and isinstance(told, dict):
        yield told
        told = told.get("init", {})


def shares_holes(told: dict[str, Any], data: Episode, fingerprint: str) -> bool:
    """Whether a run was trained on these data, or at holes that are among theirs.

    Args:
        told: One of ``lineage``.
        data: Stacked episodes.
        fingerprint: Of the data.
    """
    if told.get("data") == fingerprint:
        return True
    hole = told.get("first_hole")
    if hole is None:
        return False
    same = np.asarray(data.sequence) == hole["sequence"]
    places = np.asarray(data.rollout.truth.hole_pos_world)[same]
    return bool(np.isclose(places, hole["pos_world"], rtol=0, atol=1e-6).all(axis=-1).any())


def require_new(run: Path, data: Episode, fingerprint: str) -> None:
    """Make sure that a run was not trained on these data, nor at these holes, nor what it started from.

    Args:
        run: Folder of the run.
        data: Stacked episodes.
        fingerprint: Of the data.

    Raises:
        RequestError: It was, or its ``run.json`` does not say.
    """
    for told in lineage(told_by(run)):
        if told.get("data") == fingerprint:
            raise RequestError("--data: the data that the run was trained on cannot be used: collect others")
        if not shares_holes(told, data, fingerprint):
            continue
        raise RequestError(
            "--data: the holes that the run was trained at cannot be used: collect with another --seed"
        )


def require_world(request: dict[str, Any], config: Config) -> None:
    """Make sure that data were made in the world that the configuration describes.

    Args:
        request: What the data set was asked to be.
        config: ``scene`` and ``control`` are used.

    Raises:
        RequestError: Its scene or controller is another.
    """
    there = config_from_tree(request["config"])
    differences = [words for words in config_differences(there, config) if words.split(".")[0] in WORLD]
    if differences:
        raise RequestError(
            f"--data: not usable with this configuration: {differences[0]}; give the --config and --set "
            "that the data were collected with"
        )
