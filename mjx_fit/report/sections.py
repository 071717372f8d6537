"""What a report says about one input: facts, rows and pictures."""

import base64
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax
import yaml
from pydantic import TypeAdapter

from mjx_fit.config.schema import config_from_tree
from mjx_fit.data import reader
from mjx_fit.data.episode import happened
from mjx_fit.data.manifest import read_manifest
from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.statistics import Row
from mjx_fit.report import descriptions, narrative, paper_values
from mjx_fit.report.figures import catalogue, data_set, training_run
from mjx_fit.report.figures.catalogue import Drawing
from mjx_fit.report.figures.style import Picture, picture
from mjx_fit.report.narrative import Story
from mjx_fit.utils import bounded_json
from mjx_fit.utils.errors import RequestError

VIDEOS = {".mp4": "video/mp4", ".gif": "image/gif"}
_BEGINS = {".mp4": (4, b"ftyp"), ".gif": (0, b"GIF8")}
"""At which byte such a file has what."""
_FACTS = TypeAdapter(dict[str, Any])
LARGEST_CONFIG = 2**20
"""Bytes of a configuration that is shown."""
LARGEST_VIDEO = 20_000_000
"""Bytes: more than that a page had better not hold."""


@dataclass(frozen=True)
class Section:
    """One input, ready for the page.

    Attributes:
        slug: Short name, unique in a report, fit for a file name and an id.
        title: Heading.
        facts: What it was made with: (name, value).
        config: Resolved configuration as text; empty where it is not known.
        rows: Summary of a result; empty for a data set or a run.
        pictures: Figures in order.
        stories: Single trials in words.
        video: One to be shown, as ``data:`` address.
        paper: What the paper has of the rows, by method, metric and group.
        versions: Of what it was made with, by library.
        about: What the experiment asks, in a sentence or two.
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


def of_result(slug: str, result: Result) -> Section:
    """The section of a result file; an experiment without figures of its own has its table."""
    known = descriptions.told(result.experiment, [row.method for row in result.summary])
    facts = (*known, *_provenance(vars(result)))
    if differs := result.request.get("differs_from_training"):
        facts = (*facts, ("set since training", "; ".join(map(str, differs))))
    config = yaml.safe_dump(result.config, sort_keys=False)
    title = f"Experiment: {result.experiment}" + (f" ({slug})" if slug != result.experiment else "")
    pictures = _pictures(slug, catalogue.of_result(result))
    return Section(
        slug,
        title,
        facts,
        config,
        tuple(result.summary),
        pictures,
        narrative.of_result(result),
        paper=paper_values.beside(result.config),
        versions=result.versions,
        about=descriptions.about(result.experiment),
    )


def of_video(slug: str, path: Path) -> Section:
    """The section of a video, which the page carries in itself.

    Raises:
        RequestError: It is too large for that, or no video.
    """
    size = path.stat().st_size
    if size > LARGEST_VIDEO:
        raise RequestError(
            f"report: {path} cannot be used: it has {size / 1e6:.0f} MB, and a page takes videos up to "
            f"{LARGEST_VIDEO / 1e6:.0f} MB; render it with fewer --fps or more --speed"
        )
    content, (at, begins) = path.read_bytes(), _BEGINS[path.suffix]
    if not content.startswith(begins, at):
        raise RequestError(f"report: {path} cannot be used: it is no {path.suffix} video")
    address = f"data:{VIDEOS[path.suffix]};base64,{base64.b64encode(content).decode()}"
    return Section(slug, f"Video: {path.stem}", (), "", (), video=address)


def of_run(slug: str, folder: Path) -> Section:
    """The section of a training run."""
    metrics = training_run.read_metrics(folder / "metrics.jsonl")
    caption = (
        "How well the updated belief explains the true state of the hole, epoch by epoch, against the belief "
        "before the attempt; lower is better."
    )
    pictures = _pictures(slug, [("training", caption, lambda: training_run.training_curve(metrics))])
    facts = (("epochs", str(len(metrics))), *_provenance(_json_of(folder / "run.json")))
    path = folder / "config.yaml"
    config = _text_of(path)
    return Section(slug, f"Training: {folder.resolve().name}", facts, config, (), pictures)


def of_dataset(slug: str, folder: Path) -> Section:
    """The section of a data set.

    Raises:
        RequestError: There is no valid interaction in it.
    """
    manifest, episodes = read_manifest(folder), reader.load(folder)
    keep = happened(episodes)
    data = jax.tree.map(lambda leaf: leaf[keep], episodes.rollout)
    asked = config_from_tree(manifest.request["config"])
    if not len(data.felt.length):
        raise RequestError(f"report: {folder} holds no valid interaction; nothing can be shown")
    shown: list[Drawing] = [
        (
            "visited",
            "Coverage: where the tip was from the hole's true centre (cross) at the end of every action.",
            lambda: data_set.visited_positions(data),
        ),
        (
            "lengths",
            "Share of the pegs not inserted yet (Kaplan-Meier, since some interactions are cut off earlier).",
            lambda: data_set.interaction_lengths(data, manifest.shapes),
        ),
        (
            "forces",
            "Forces by pair in actions with some contact, moments without it included: median (dot), middle "
            "half (bar) and middle 90 % (line) of the samples.",
            lambda: data_set.forces_by_pair(data, asked),
        ),
    ]
    pictures = _pictures(slug, shown)
    config = yaml.safe_dump(manifest.request["config"], sort_keys=False)
    return Section(slug, f"Data set: {folder.resolve().name}", _data_facts(folder), config, (), pictures)


def _data_facts(folder: Path) -> tuple[tuple[str, str], ...]:
    """How a data set was made, and what came of it, in words."""
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
        ("asked for", f"{request['episodes']:,} interactions of up to {request['steps']} actions"),
        (
            "policy",
            request["policy"]
            + (f", {request['sequence']} in a row at one hole" if request["sequence"] > 1 else ""),
        ),
        *([("part", f"{index} of {of}")] if of > 1 else []),
        ("performed", f"{told['episodes'] - told['not_performed'] - told['invalid']:,}"),
        *([("not performed", f"{told['not_performed']}: inserted before")] if told["not_performed"] else []),
        ("actions", f"{told['actions']:,}, {told['contact_fraction']:.1%} of them with some contact"),
        ("inserted", rates),
        ("inserted by pair", pairs),
        *([("inserted wrongly", wrongly)] if wrongly else []),
        ("left out, not finite", str(told["invalid"])),
        ("size", size),
        *_provenance(request | {"device": " and ".join(told["devices"]), "versions": manifest.versions}),
    )


def _inserted_by_pair(pairs: dict[str, dict[str, int]], names: tuple[str, ...]) -> str:
    """In words; where there are many pairs, those that do not match are one."""
    shown = pairs
    if len(pairs) > data_set.MOST_ROWS:
        shown = {f"{name}-{name}": pairs[f"{name}-{name}"] for name in names if f"{name}-{name}" in pairs}
        others = [row for pair, row in pairs.items() if pair not in shown]
        shown["all others"] = {key: sum(row[key] for row in others) for key in ("inserted", "episodes")}
    return ", ".join(f"{pair} {row['inserted']} of {row['episodes']}" for pair, row in shown.items())


def _pictures(slug: str, shown: list[Drawing]) -> tuple[Picture, ...]:
    return tuple(picture(f"{slug}-{name}", caption, draw) for name, caption, draw in shown)


def _provenance(tree: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    """Seed, engine, device and versions, as far as they were written down."""
    facts = []
    for name in ("seed", "engine", "device", "versions"):
        value = tree.get(name)
        if isinstance(value, dict):
            value = ", ".join(f"{library} {version}" for library, version in value.items())
        if value is not None:
            facts.append((name, str(value)))
    return tuple(facts)


def _text_of(path: Path) -> str:
    """A file to be shown as it is, without what no page may hold; empty where there is none."""
    try:
        text = bounded_json.read_text(path, LARGEST_CONFIG)
    except (OSError, ValueError):
        return ""
    return "".join(letter for letter in text if letter.isprintable() or letter == "\n")


def _json_of(path: Path) -> dict[str, Any]:
    try:
        tree = bounded_json.check(_FACTS, bounded_json.read(path))
    except (OSError, ValueError):
        return {}  # facts beside the figures: a run of another making may lack them
    return tree
