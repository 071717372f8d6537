"""Section of a data set: how it was collected, what happened, and figures of it."""

from pathlib import Path

import jax
import yaml

from mjx_fit.config.schema import config_from_stored
from mjx_fit.data import reader
from mjx_fit.data.episode import happened
from mjx_fit.data.manifest import read_manifest
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
    shown: list[Drawing] = [
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
        (
            "forces",
            "Contact force by pair: median (dot), middle 50 % (bar) and middle 90 % (line) of the samples "
            "of actions with contact, moments without contact included.",
            lambda: data_set.forces_by_pair(data, asked),
        ),
    ]
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
    rates = ", ".join(
        f"{name} {'-' if rate is None else f'{rate:.1%}'}" for name, rate in told["success_rate"].items()
    )
    pairs = _inserted_by_pair(told["pairs"], manifest.shapes)
    wrongly = ", ".join(
        f"{pair} {row['inserted_wrongly']} of {row['episodes']}"
        for pair, row in told["pairs"].items()
        if "inserted_wrongly" in row
    )
    size = f"{told['bytes'] / 1e6:,.0f} MB in {told['shards']} files"
    return (
        ("requested", f"{request['episodes']:,} interactions of up to {request['steps']} actions"),
        (
            "policy",
            request["policy"]
            + (
                f", {request['sequence']} consecutive attempts at each hole"
                if request["sequence"] > 1
                else ""
            ),
        ),
        *([("part", f"{index} of {of}")] if of > 1 else []),
        ("performed", f"{told['episodes'] - told['not_performed'] - told['invalid']:,}"),
        *(
            [("not performed", f"{told['not_performed']}: peg already inserted")]
            if told["not_performed"]
            else []
        ),
        ("actions", f"{told['actions']:,}, {told['contact_fraction']:.1%} of them in contact"),
        ("inserted", rates),
        ("inserted by pair", pairs),
        *([("inserted wrongly", wrongly)] if wrongly else []),
        ("excluded, diverged", str(told["invalid"])),
        ("size", size),
        *provenance(request | {"device": " and ".join(told["devices"]), "versions": manifest.versions}),
    )


def _inserted_by_pair(pairs: dict[str, dict[str, int]], names: tuple[str, ...]) -> str:
    """Format inserted counts per pair; many mismatched pairs are merged into one entry."""
    shown = pairs
    if len(pairs) > data_set.MOST_ROWS:
        shown = {f"{name}-{name}": pairs[f"{name}-{name}"] for name in names if f"{name}-{name}" in pairs}
        others = [row for pair, row in pairs.items() if pair not in shown]
        shown["mismatched"] = {key: sum(row[key] for row in others) for key in ("inserted", "episodes")}
    return ", ".join(f"{pair} {row['inserted']} of {row['episodes']}" for pair, row in shown.items())
