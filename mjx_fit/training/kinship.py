"""Whether a sensor may be judged on a data set: not on holes that it was trained on, nor in another world."""

from pathlib import Path
from typing import Annotated, Any, NotRequired

import numpy as np
from pydantic import Field, TypeAdapter
from typing_extensions import TypedDict

from mjx_fit import bounded_json
from mjx_fit import config as config_
from mjx_fit.config import Config
from mjx_fit.dataset.episode import Episode
from mjx_fit.errors import RequestError
from mjx_fit.training import run_folder

_Metres = Annotated[float, Field(ge=-10, le=10, allow_inf_nan=False)]


class _Hole(TypedDict):
    sequence: int
    pos_world: Annotated[list[_Metres], Field(min_length=2, max_length=2)]


class _Told(TypedDict):
    """What a run says of its data; earlier ones did not name a hole."""

    data: NotRequired[str]
    first_hole: NotRequired[_Hole | None]


_TOLD = TypeAdapter(_Told)

WORLD = ("scene", "control")
"""Sections of the configuration that what is felt in a data set depends on, whatever was done there."""


def first_hole(data: Episode) -> dict[str, Any]:
    """The hole of the first sequence, which tells the seed: draws depend on it and on the number alone."""
    row = int(np.argmin(np.asarray(data.sequence)))
    position = np.asarray(data.interaction.hole_pos_world)[row]
    return {"sequence": int(data.sequence[row]), "pos_world": [round(float(x), 7) for x in position]}


def require_new(run: Path, data: Episode, fingerprint: str) -> None:
    """Make sure that a run was not trained on these data, nor at these holes.

    Args:
        run: Folder of the run.
        data: Stacked episodes.
        fingerprint: Of the data.

    Raises:
        RequestError: It was, or its ``run.json`` does not say.
    """
    path = run / run_folder.RUN
    try:
        told = bounded_json.check(_TOLD, bounded_json.read(path)) if path.is_file() else {}
    except (OSError, ValueError) as error:
        raise RequestError(f"--run: {run} is not allowed: its {path.name} cannot be read: {error}") from None
    if told.get("data") == fingerprint:
        raise RequestError("--data: the data that the run was trained on are not allowed: collect others")
    hole = told.get("first_hole")
    if hole is None:
        return
    same = np.asarray(data.sequence) == hole["sequence"]
    places = np.asarray(data.interaction.hole_pos_world)[same]
    if np.isclose(places, hole["pos_world"], rtol=0, atol=1e-6).all(axis=-1).any():
        raise RequestError(
            "--data: the holes that the run was trained at are not allowed: collect with another --seed"
        )


def require_world(request: dict[str, Any], config: Config) -> None:
    """Make sure that data were made in the world that the configuration describes.

    Args:
        request: What the data set was asked to be.
        config: ``scene`` and ``control`` are used.

    Raises:
        RequestError: Its scene or controller is another.
    """
    there = config_.from_tree(request["config"])
    differences = [words for words in config_.differences(there, config) if words.split(".")[0] in WORLD]
    if differences:
        raise RequestError(
            f"--data: not allowed with this configuration: {differences[0]}; give the --config and --set "
            "that the data were collected with"
        )
