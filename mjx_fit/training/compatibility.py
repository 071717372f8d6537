"""Check that a sensor may be evaluated on a data set: no training holes, same scene and controller."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, NotRequired

import numpy as np
from pydantic import Field, TypeAdapter
from typing_extensions import TypedDict

from mjx_fit.config.quantities import NUMERICAL, QUANTITIES
from mjx_fit.config.randomized import difference, not_covered
from mjx_fit.config.schema import Config, config_differences, config_from_stored
from mjx_fit.data.episode import Episode
from mjx_fit.data.manifest_schema import MAX_EPISODES
from mjx_fit.training import run_files
from mjx_fit.training.run_files import RUN
from mjx_fit.utils import bounded_json
from mjx_fit.utils.errors import RequestError

_Metres = Annotated[float, Field(ge=-10, le=10, allow_inf_nan=False)]


class _Hole(TypedDict):
    sequence: int
    pos_world: Annotated[list[_Metres], Field(min_length=2, max_length=2)]


class _Told(TypedDict):
    """Record of a run's training data; earlier versions did not name a hole."""

    seed: NotRequired[int]
    data: NotRequired[str]
    first_hole: NotRequired[_Hole | None]
    other_first_holes: NotRequired[Annotated[list[_Hole], Field(max_length=1000)]]
    init: NotRequired["_Told"]


_TOLD = TypeAdapter(_Told)

WORLD = ("scene", "control", "arm")
"""Sections of the configuration that determine the physics, for any policy."""


def first_holes(data: Episode) -> list[dict[str, Any]]:
    """Return the hole of the first sequence of each data set that was joined (``data.joined``).

    It identifies the seed, because draws depend on the seed and the number of the sequence alone.
    """
    found, sequence = [], np.asarray(data.sequence)
    for part in np.unique(sequence // MAX_EPISODES):
        rows = np.flatnonzero(sequence // MAX_EPISODES == part)
        row = rows[np.argmin(sequence[rows])]
        position = np.asarray(data.rollout.truth.hole_pos_world)[row]
        number = int(sequence[row] % MAX_EPISODES)
        found.append({"sequence": number, "pos_world": [round(float(x), 7) for x in position]})
    return found


def told_by(run: Path) -> dict[str, Any]:
    """Read the record of a run's training data and of its initial sensor.

    Raises:
        RequestError: ``run.json`` is damaged.
    """
    if not (run / RUN).is_file():
        return {}
    told = run_files.read(run, option="--run")
    try:
        bounded_json.check(_TOLD, told)
    except ValueError as error:
        raise run_files.damaged(run / RUN, error, "--run") from None
    return {key: told[key] for key in _Told.__annotations__ if key in told}


def lineage(told: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Iterate over the training records of a run, of its initial sensor, and so on."""
    while told and isinstance(told, dict):
        yield told
        told = told.get("init", {})


def shares_holes(told: dict[str, Any], data: Episode, fingerprint: str) -> bool:
    """Return True if a run was trained on these data, or at some of their holes.

    Args:
        told: Record from ``lineage``.
        data: Stacked episodes.
        fingerprint: Fingerprint of the data.
    """
    if told.get("data") == fingerprint:
        return True
    holes = [hole for hole in (told.get("first_hole"), *told.get("other_first_holes", ())) if hole]
    number = np.asarray(data.sequence) % MAX_EPISODES
    places = np.asarray(data.rollout.truth.hole_pos_world)
    return any(
        np.isclose(places[number == hole["sequence"]], hole["pos_world"], rtol=0, atol=1e-6).all(-1).any()
        for hole in holes
    )


def require_new(run: Path, data: Episode, fingerprint: str) -> None:
    """Check that neither a run nor its initial sensors were trained on these data or at these holes.

    Args:
        run: Folder of the run.
        data: Stacked episodes.
        fingerprint: Fingerprint of the data.

    Raises:
        RequestError: The run shares data or holes, or its ``run.json`` is damaged.
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
    """Check that the data come from the world of the configuration.

    Contact slots are a property of the world only in data that MJX has collected.

    Args:
        request: Request that the data set was collected with.
        config: Configuration, with its sections in ``WORLD`` and ``randomize`` in use.

    Raises:
        RequestError: The scene, the controller or the arm differs, or a quantity that differs between worlds
            has values there that it never has here.
    """
    there = config_from_stored(request["config"])
    exempt = () if request["engine"] == "mjx" else NUMERICAL
    differences = config_differences(
        there, config, lambda section, key: _is_constant(section, key) and key not in exempt
    )
    differences += [difference(name, there, config) for name in not_covered(config, there, QUANTITIES)]
    if differences:
        raise RequestError(
            f"--data: not usable with this configuration: {differences[0]}; use the --config and --set "
            "of the data collection"
        )


def _is_constant(section: str, key: str) -> bool:
    """Return True for what is the same in all worlds of a configuration; quantities have ranges."""
    return section in WORLD and key not in QUANTITIES
