"""Sweeps: a configuration with a section ``sweep``, which says what to vary and what to run."""

import itertools
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as schema

from mjx_fit.config import schema_errors
from mjx_fit.config.files import config_tree
from mjx_fit.config.quantities import QUANTITIES
from mjx_fit.config.schema import Config, config_from_tree
from mjx_fit.config.sections.fields import STRICT
from mjx_fit.utils.errors import RequestError, shown

MOST_CELLS = 10_000
"""Most settings times seeds."""

_Key = Annotated[str, Field(pattern=r"^[a-z_]+\.[a-z0-9_]+$", max_length=100)]
_Settings = dict[_Key, Any]
_Count = Annotated[int, Field(ge=1, le=MOST_CELLS)]


@schema(frozen=True, config=STRICT)
class SweepPlan:
    """What a sweep runs.

    Attributes:
        experiment: Experiment of every cell.
        keys: Values of each key of the configuration, in all combinations; or a list of settings, each with
            some keys. A setting keeps the configuration where it names no key.
        trials: Trials of each cell, as ``--trials`` of the experiment.
        seeds: Root seeds of each setting: how many, from 0, or which. Settings share the draws of a seed.
        methods: Methods; ``attempt`` has none.
    """

    experiment: Literal["attempt", "position", "insertion", "assembly"]
    keys: (
        dict[_Key, Annotated[list[Any], Field(min_length=1)]]
        | Annotated[list[_Settings], Field(min_length=1)]
    )
    trials: _Count = 100
    seeds: _Count | Annotated[list[Annotated[int, Field(ge=0, lt=2**32)]], Field(min_length=1)] = 1
    methods: list[str] = Field(default_factory=list)

    def __post_init__(self) -> None:
        if (self.experiment == "attempt") == bool(self.methods):
            expected = "none for attempt" if self.methods else "names of methods"
            raise ValueError(
                f"methods: {', '.join(self.methods) or 'nothing'} is invalid: expected {expected}"
            )

    @property
    def root_seeds(self) -> tuple[int, ...]:
        """Root seeds of each setting."""
        return tuple(range(self.seeds)) if isinstance(self.seeds, int) else tuple(self.seeds)

    @property
    def cells(self) -> int:
        """Number of settings times seeds; a grid may mean more than can be listed."""
        keys = self.keys
        settings = len(keys) if isinstance(keys, list) else math.prod(map(len, keys.values()))
        return settings * len(self.root_seeds)

    @property
    def settings(self) -> tuple[dict[str, Any], ...]:
        """Values of the keys of each setting."""
        if isinstance(self.keys, list):
            return tuple(self.keys)
        combined = itertools.product(*self.keys.values())
        return tuple(dict(zip(self.keys, values, strict=True)) for values in combined)


@dataclass(frozen=True)
class Sweep:
    """A sweep that was read.

    Attributes:
        plan: What it runs.
        base: Configuration without the settings.
        configs: Configuration of each setting.
    """

    plan: SweepPlan
    base: Config
    configs: tuple[Config, ...]


def read_sweep(paths: Sequence[Path], overrides: Sequence[str] = ()) -> Sweep:
    """Read a sweep.

    Args:
        paths: Files as in ``read_config``; one of them has the section ``sweep``.
        overrides: Strings ``section.key=value``, applied after the files and before the settings.

    Raises:
        RequestError: A file cannot be read, or a key or value is invalid, of the sweep or of a setting.
    """
    tree = config_tree(paths, overrides)
    if not isinstance(tree.get("sweep"), dict):
        what = f"{shown(tree['sweep'])} is invalid" if "sweep" in tree else "it is missing"
        raise RequestError(f"config: sweep: {what}: expected a section with experiment and keys")
    try:
        plan = TypeAdapter(SweepPlan).validate_json(json.dumps(tree.pop("sweep"), default=shown))
    except ValidationError as error:
        raise RequestError(f"config: sweep: {schema_errors.in_words(error, SweepPlan)}") from None
    if plan.cells > MOST_CELLS:
        raise RequestError(
            f"config: sweep: {plan.cells} cells are out of range: expected at most {MOST_CELLS}"
        )
    if len(set(plan.root_seeds)) < len(plan.root_seeds):
        raise RequestError("config: sweep.seeds: a seed is given twice: expected each once")
    return Sweep(plan, config_from_tree(tree), tuple(_changed(tree, one) for one in plan.settings))


def _changed(tree: dict[str, Any], settings: dict[str, Any]) -> Config:
    new = {name: dict(section) if isinstance(section, dict) else section for name, section in tree.items()}
    for path, value in settings.items():
        section, _, key = path.partition(".")
        new.setdefault(section, {})[key] = value
    try:
        config = config_from_tree(new)
        for path in settings:
            _require_effect(path, config)
    except RequestError as error:
        told = ", ".join(f"{path}={shown(value)}" for path, value in settings.items())
        raise RequestError(f"config: sweep.keys: {told} cannot be used: {error}") from None
    return config


def _require_effect(path: str, config: Config) -> None:
    """Refuse a key whose value every world draws for itself."""
    section, _, key = path.partition(".")
    known = QUANTITIES.get(key)
    if known is not None and known.section == section and getattr(config.randomize, key) is not None:
        raise RequestError(f"{path} has no effect: randomize.{key} draws it: vary that, or set it to null")
