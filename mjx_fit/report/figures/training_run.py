"""Figure of a training run."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NotRequired

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from pydantic import ConfigDict, Field, TypeAdapter
from typing_extensions import TypedDict

from mjx_fit.report.figures import style
from mjx_fit.utils import bounded_json
from mjx_fit.utils.errors import RequestError

LARGEST, LARGEST_LINE = 2**30, 2**16
"""Largest ``metrics.jsonl`` and largest line, in bytes: a million epochs."""

_Measure = Annotated[float, Field(ge=-1e12, le=1e12, allow_inf_nan=False)]


class _Record(TypedDict):
    """Values of an epoch that are drawn."""

    __pydantic_config__ = ConfigDict(strict=True)  # pyright: ignore[reportGeneralTypeIssues]

    epoch: Annotated[int, Field(ge=0, le=10**9)]
    nll: NotRequired[_Measure | None]
    val_nll: NotRequired[_Measure | None]
    prior_nll: NotRequired[_Measure | None]


_RECORD = TypeAdapter(_Record)


def read_metrics(path: Path) -> list[dict[str, Any]]:
    """Return the epochs of a ``metrics.jsonl`` in order, each with its last record.

    The last line may be incomplete if the run is still running or was killed.

    Raises:
        RequestError: The file cannot be read, or contains no epoch.
    """
    epochs: dict[int, dict[str, Any]] = {}
    try:
        lines = bounded_json.read_text(path, LARGEST).split("\n")
    except (OSError, ValueError) as error:
        raise RequestError(f"report: {path} cannot be read: {error}") from None
    lines = lines if lines[-1] else lines[:-1]
    for number, line in enumerate(lines, 1):
        try:
            record = bounded_json.check(_RECORD, bounded_json.loads(line, LARGEST_LINE, nan_is_null=True))
            epochs[record["epoch"]] = record
        except ValueError as error:
            if number < len(lines) or not isinstance(error, json.JSONDecodeError):
                raise RequestError(
                    f"report: {path} line {number} is not a record with an epoch: {error}"
                ) from None
    if not epochs:
        raise RequestError(f"report: {path} contains no epoch yet: nothing to show")
    return [epochs[epoch] for epoch in sorted(epochs)]


def training_curves(runs: Mapping[str, Sequence[dict[str, Any]]]) -> Figure:
    """Draw the negative log-likelihood of the true state in validation, by epoch, of several runs.

    Args:
        runs: Records of each run, by the name that the legend shows.
    """
    figure, ax = style.axes()
    colours, markers = style.colours(list(runs)), style.markers(list(runs))
    for name, metrics in runs.items():
        epoch = np.array([record["epoch"] for record in metrics])
        value = np.array([record.get("val_nll") for record in metrics], float)
        seen = np.isfinite(value)
        ax.plot(
            epoch[seen],
            value[seen],
            color=colours[name],
            marker=markers[name],
            markersize=4,
            markevery=max(1, int(seen.sum()) // 10),
            label=style.label(name),
        )
    ax.set(xlabel="Epoch", ylabel="Validation NLL (nat)")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    style.legend(figure, ax.get_legend_handles_labels()[0])
    return figure


def training_curve(metrics: list[dict[str, Any]]) -> Figure:
    """Draw the negative log-likelihood of the true state under posterior and prior, by epoch.

    Args:
        metrics: Records of a run; ``nll``, ``val_nll`` and ``prior_nll`` are drawn where present.
    """
    figure, ax = style.axes()
    epoch = np.array([record["epoch"] for record in metrics])
    lines = (
        ("nll", "training", "#999999", "-"),
        ("val_nll", "validation", "#0072B2", "-"),
        ("prior_nll", "prior", "#D55E00", "--"),
    )
    few = "o" if len(epoch) < 30 else ""
    for key, name, colour, dash in lines:
        value = np.array([record.get(key) for record in metrics], float)
        if np.isfinite(value).any():
            seen = np.isfinite(value)
            ax.plot(epoch[seen], value[seen], dash, color=colour, label=name, marker=few, markersize=4)
    ax.set(xlabel="Epoch", ylabel="Negative log-likelihood (nat)")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    handles = ax.get_legend_handles_labels()[0]
    if handles:
        style.legend(figure, handles)
    return figure
