"""Sections of a report: facts, claims, rows and figures of one input."""

import base64
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import jax
import yaml
from pydantic import TypeAdapter

from mjx_fit.config.schema import config_from_stored
from mjx_fit.data import reader
from mjx_fit.data.episode import happened
from mjx_fit.data.manifest import read_manifest
from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.statistics import Row
from mjx_fit.report import claims, descriptions, narrative, paper_values
from mjx_fit.report.figures import catalogue, data_set, training_run
from mjx_fit.report.figures.catalogue import Drawing
from mjx_fit.report.figures.style import Picture, picture
from mjx_fit.report.narrative import Story
from mjx_fit.utils import bounded_json
from mjx_fit.utils.errors import RequestError

VIDEOS = {".mp4": "video/mp4", ".gif": "image/gif"}
_BEGINS = {".mp4": (4, b"ftyp"), ".gif": (0, b"GIF8")}
"""Offset and content of the magic bytes of each format."""
_FACTS = TypeAdapter(dict[str, Any])
LARGEST_CONFIG = 2**20
"""Largest configuration file shown, in bytes."""
LARGEST_VIDEO = 20_000_000
"""Largest video embedded in a page, in bytes."""


@dataclass(frozen=True)
class Section:
    """One input, ready for the page.

    Attributes:
        slug: Short name, unique in a report, valid as a file name and an id.
        title: Heading.
        facts: Provenance and descriptions: (name, value).
        config: Resolved configuration as text; empty if unknown.
        rows: Summary of a result; empty for a data set or a run.
        pictures: Figures in order.
        stories: Single trials in words.
        video: Video to show, as ``data:`` address.
        paper: Values of the paper, by method, metric and group.
        versions: Library versions.
        about: Description of the experiment in a sentence or two.
        kind: Name of the experiment, ``data set``, ``training run`` or ``video``.
        claims: Claims that the rows support, in words.
        types: Names of the types that figures distinguish by colour.
    """

    slug: str
    title: str
    facts: tuple[tuple[str, str], ...]
    config: str
    rows: tuple[Row, ...]
    pictures: tuple[Picture, ...] = ()
    stories: tuple[Story, ...] = ()
    video: str = ""
    paper: Mapping[tuple[str, str, str], float] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    about: str = ""
    kind: str = ""
    claims: tuple[str, ...] = ()
    types: tuple[str, ...] = ()


def of_result(slug: str, result: Result) -> Section:
    """Return the section of a result file; an unknown experiment gets its table only."""
    known = descriptions.told(result.experiment, [row.method for row in result.summary])
    facts = (*known, *_provenance(vars(result)))
    if differs := result.request.get("differs_from_training"):
        facts = (*facts, ("changed since training", "; ".join(map(str, differs))))
    config = yaml.safe_dump(result.config, sort_keys=False)
    title = f"Experiment: {result.experiment}" + (f" ({slug})" if slug != result.experiment else "")
    pictures = _pictures(slug, catalogue.of_result(result))
    section = Section(slug, title, facts, config, tuple(result.summary), pictures)
    return replace(
        section,
        stories=narrative.of_result(result),
        paper=paper_values.beside(result.config),
        versions=result.versions,
        about=descriptions.about(result.experiment),
        kind=result.experiment,
        claims=claims.of_result(result),
    )


def of_video(slug: str, path: Path) -> Section:
    """Return the section of a video, which is embedded in the page.

    Raises:
        RequestError: The file is too large to embed, or not a video.
    """
    size = path.stat().st_size
    if size > LARGEST_VIDEO:
        raise RequestError(
            f"report: {path} cannot be used: it has {size / 1e6:.0f} MB, the limit of a page is "
            f"{LARGEST_VIDEO / 1e6:.0f} MB; render it with a lower --fps or a higher --speed"
        )
    content, (at, begins) = path.read_bytes(), _BEGINS[path.suffix]
    if not content.startswith(begins, at):
        raise RequestError(f"report: {path} cannot be used: it is not a {path.suffix} video")
    address = f"data:{VIDEOS[path.suffix]};base64,{base64.b64encode(content).decode()}"
    return Section(slug, f"Video: {path.stem}", (), "", (), video=address, kind="video")


def of_run(slug: str, folder: Path) -> Section:
    """Return the section of a training run."""
    metrics = training_run.read_metrics(folder / "metrics.jsonl")
    caption = (
        "Negative log-likelihood of the true hole state under the posterior, by epoch, and under the prior "
        "(dashed); lower is better."
    )
    pictures = _pictures(slug, [("training", caption, lambda: training_run.training_curve(metrics))])
    facts = (("epochs", str(len(metrics))), *_provenance(_json_of(folder / "run.json")))
    path = folder / "config.yaml"
    config = _text_of(path)
    title = f"Training: {folder.resolve().name}"
    return Section(slug, title, facts, config, (), pictures, kind="training run")


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
    pictures = _pictures(slug, shown)
    config = yaml.safe_dump(manifest.request["config"], sort_keys=False)
    title, facts = f"Data set: {folder.resolve().name}", _data_facts(folder)
    return Section(slug, title, facts, config, (), pictures, kind="data set", types=manifest.shapes)


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
        *_provenance(request | {"device": " and ".join(told["devices"]), "versions": manifest.versions}),
    )


def _inserted_by_pair(pairs: dict[str, dict[str, int]], names: tuple[str, ...]) -> str:
    """Format inserted counts per pair; many mismatched pairs are merged into one entry."""
    shown = pairs
    if len(pairs) > data_set.MOST_ROWS:
        shown = {f"{name}-{name}": pairs[f"{name}-{name}"] for name in names if f"{name}-{name}" in pairs}
        others = [row for pair, row in pairs.items() if pair not in shown]
        shown["mismatched"] = {key: sum(row[key] for row in others) for key in ("inserted", "episodes")}
    return ", ".join(f"{pair} {row['inserted']} of {row['episodes']}" for pair, row in shown.items())


def _pictures(slug: str, shown: list[Drawing]) -> tuple[Picture, ...]:
    return tuple(picture(f"{slug}-{name}", caption, draw) for name, caption, draw in shown)


def _provenance(tree: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    """Return seed, engine, device and versions, as far as they are stored."""
    facts = []
    for name in ("seed", "engine", "device", "versions"):
        value = tree.get(name)
        if isinstance(value, dict):
            value = ", ".join(f"{library} {version}" for library, version in value.items())
        if value is not None:
            facts.append((name, str(value)))
    return tuple(facts)


def _text_of(path: Path) -> str:
    """Return a text file without unprintable characters; empty if it cannot be read."""
    try:
        text = bounded_json.read_text(path, LARGEST_CONFIG)
    except (OSError, ValueError):
        return ""
    return "".join(letter for letter in text if letter.isprintable() or letter == "\n")


def _json_of(path: Path) -> dict[str, Any]:
    try:
        tree = bounded_json.check(_FACTS, bounded_json.read(path))
    except (OSError, ValueError):
        return {}  # optional: a run made elsewhere may lack this file
    return tree
