"""Section of a data set: how it was collected, what happened, and figures of it."""

from pathlib import Path
from typing import Any

import jax
import yaml

from mjx_fit.config.schema import config_from_stored
from mjx_fit.data import reader
from mjx_fit.data.episode import happened
from mjx_fit.data.manifest import ROBOT, knows_truth, read_manifest
from mjx_fit.report.figures import data_set
from mjx_fit.report.figures.catalogue import Drawing
from mjx_fit.report.sections import Section, pictures_of, provenance
from mjx_fit.utils.errors import RequestError


def of_dataset(slug: str, folder: Path) -> Section:
    """Return the section of a data set.

    Raises:
        RequestError: It contains no valid interaction.
    """
    manifest, episodes = read_manifest(folder), reader.load(folder)
    keep = happened(episodes)
    data = jax.tree.map(lambda leaf: leaf[keep], episodes.rollout)
    asked = config_from_stored(manifest.request["config"])
    if not len(data.felt.length):
        raise RequestError(f"report: {folder} contains no valid interaction: nothing to show")
    known = knows_truth(manifest.request)
    forces: Drawing = (
        "forces",
        f"Contact force by {'pair' if known else 'peg'}: median (dot), middle 50 % (bar) and middle 90 % "
        "(line) of the samples of actions with contact, moments without contact included.",
        lambda: data_set.forces_by_pair(data, asked),
    )
    of_truth: list[Drawing] = [
        (
            "visited",
            "Coverage: end-effector position relative to the true hole centre (cross) after each action.",
            lambda: data_set.visited_positions(data),
        ),
        (
            "lengths",
            "Share of pegs not yet inserted (Kaplan-Meier estimate, since some interactions end earlier).",
            lambda: data_set.interaction_lengths(data, manifest.shapes),
        ),
    ]
    shown: list[Drawing] = [*of_truth, forces] if known else [forces]
    pictures = pictures_of(slug, shown)
    config = yaml.safe_dump(manifest.request["config"], sort_keys=False)
    title, facts = f"Data set: {folder.resolve().name}", _data_facts(folder)
    types, scene = manifest.shapes, asked.scene
    return Section(slug, title, facts, config, (), pictures, kind="data set", types=types, scene=scene)


def _data_facts(folder: Path) -> tuple[tuple[str, str], ...]:
    """Describe how a data set was collected, and its outcome."""
    manifest, told = read_manifest(folder), reader.describe(folder)
    request = manifest.request
    index, of = manifest.part
    size = f"{told['bytes'] / 1e6:,.0f} MB in {told['shards']} files"
    several = f", {request['sequence']} consecutive attempts at each hole" if request["sequence"] > 1 else ""
    return (
        ("requested", f"{request['episodes']:,} interactions of up to {request['steps']} actions"),
        ("policy", request["policy"] + several),
        *([("part", f"{index} of {of}")] if of > 1 else []),
        ("performed", f"{told['episodes'] - told['not_performed'] - told['invalid']:,}"),
        *(
            [("not performed", f"{told['not_performed']}: peg already inserted")]
            if told["not_performed"]
            else []
        ),
        ("actions", f"{told['actions']:,}, {told['contact_fraction']:.1%} of them in contact"),
        *(_of_logs(told) if request["engine"] == ROBOT else ()),
        *(_outcomes(told, manifest.shapes) if knows_truth(request) else ()),
        ("size", size),
        *provenance(request | {"device": " and ".join(told["devices"]), "versions": manifest.versions}),
    )


def _of_logs(told: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    """Describe the logs of a robot."""
    return (
        ("logs", ", ".join(f"{name} ({count})" for name, count in told["logs"].items())),
        ("pegs", ", ".join(f"{name} {count}" for name, count in told["pegs"].items())),
    )


def _outcomes(told: dict[str, Any], shapes: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """Describe which pegs went in, and which simulations diverged."""
    rates = ", ".join(
        f"{name} {'-' if rate is None else f'{rate:.1%}'}" for name, rate in told["success_rate"].items()
    )
    wrongly = ", ".join(
        f"{pair} {row['inserted_wrongly']} of {row['episodes']}"
        for pair, row in told["pairs"].items()
        if "inserted_wrongly" in row
    )
    return (
        ("inserted", rates),
        ("inserted by pair", _inserted_by_pair(told["pairs"], shapes)),
        *([("inserted wrongly", wrongly)] if wrongly else []),
        ("excluded, diverged", str(told["invalid"])),
    )


def _inserted_by_pair(pairs: dict[str, dict[str, int]], names: tuple[str, ...]) -> str:
    """Format inserted counts per pair; many mismatched pairs are merged into one entry."""
    shown = pairs
    if len(pairs) > data_set.MOST_ROWS:
        shown = {f"{name}-{name}": pairs[f"{name}-{name}"] for name in names if f"{name}-{name}" in pairs}
        others = [row for pair, row in pairs.items() if pair not in shown]
        shown["mismatched"] = {key: sum(row[key] for row in others) for key in ("inserted", "episodes")}
    return ", ".join(f"{pair} {row['inserted']} of {row['episodes']}" for pair, row in shown.items())
