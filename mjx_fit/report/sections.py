"""What a report says about one input: facts, rows and pictures."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import yaml
from matplotlib.figure import Figure

from mjx_fit.dataset import manifest as manifest_
from mjx_fit.dataset import store
from mjx_fit.dataset.episode import happened
from mjx_fit.errors import RequestError
from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.statistics import Row
from mjx_fit.report import calibration_figures, data_figures, figures, run_figures
from mjx_fit.report.style import Picture, picture

_Drawing = tuple[str, str, Callable[[], Figure]]


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
    """

    slug: str
    title: str
    facts: tuple[tuple[str, str], ...]
    config: str
    rows: tuple[Row, ...]
    pictures: tuple[Picture, ...]


def of_result(slug: str, result: Result) -> Section:
    """The section of a result file; an experiment without figures of its own has its table."""
    facts = _provenance(vars(result))
    drawings: list[_Drawing] = []
    if result.trials and result.experiment == "assembly":
        drawings = _assembly(result)
    elif result.trials and result.experiment == "attempt":
        drawings = _attempt(result)
    elif result.trials and result.experiment == "calibration":
        drawings = _calibration(result)
    config = yaml.safe_dump(result.config, sort_keys=False)
    title = f"Experiment: {result.experiment}" + (f" ({slug})" if slug != result.experiment else "")
    return Section(slug, title, facts, config, tuple(result.summary), _pictures(slug, drawings))


def of_run(slug: str, folder: Path) -> Section:
    """The section of a training run."""
    metrics = run_figures.read_metrics(folder / "metrics.jsonl")
    caption = (
        "How well the updated belief explains the true state of the hole, epoch by epoch, against the belief "
        "before the attempt; lower is better."
    )
    pictures = _pictures(slug, [("training", caption, lambda: run_figures.training_curve(metrics))])
    facts = (("epochs", str(len(metrics))), *_provenance(_json_of(folder / "run.json")))
    path = folder / "config.yaml"
    config = path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
    return Section(slug, f"Training: {folder.resolve().name}", facts, config, (), pictures)


def of_dataset(slug: str, folder: Path) -> Section:
    """The section of a data set.

    Raises:
        RequestError: There is no valid interaction in it.
    """
    manifest, episodes = manifest_.read(folder), store.load(folder)
    keep = happened(episodes)
    data = jax.tree.map(lambda leaf: leaf[keep], episodes.interaction)
    if not len(data.length):
        raise RequestError(f"report: {folder} holds no valid interaction; nothing can be shown")
    drawings: list[_Drawing] = [
        (
            "visited",
            "Coverage: where the tip was from the hole's true centre (cross) at the end of every action.",
            lambda: data_figures.visited_positions(data),
        ),
        (
            "lengths",
            "Share of the pegs not inserted yet (Kaplan-Meier, since some interactions are cut off earlier).",
            lambda: data_figures.interaction_lengths(data),
        ),
        (
            "forces",
            "Forces by pair in actions with some contact, moments without it included: median (dot), middle "
            "half (bar) and middle 90 % (line) of the samples.",
            lambda: data_figures.forces_by_pair(data),
        ),
    ]
    pictures = _pictures(slug, drawings)
    config = yaml.safe_dump(manifest.request["config"], sort_keys=False)
    return Section(slug, f"Data set: {folder.resolve().name}", _data_facts(folder), config, (), pictures)


def _data_facts(folder: Path) -> tuple[tuple[str, str], ...]:
    """How a data set was made, and what came of it, in words."""
    manifest, told = manifest_.read(folder), store.describe(folder)
    request = manifest.request
    index, of = manifest.part
    rates = ", ".join(
        f"{name} {'-' if rate is None else f'{rate:.1%}'}" for name, rate in told["success_rate"].items()
    )
    pairs = (f"{pair} {row['inserted']} of {row['episodes']}" for pair, row in told["pairs"].items())
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
        ("inserted by pair", ", ".join(pairs)),
        ("left out, not finite", str(told["invalid"])),
        ("size", size),
        *_provenance(request | {"device": " and ".join(told["devices"]), "versions": manifest.versions}),
    )


def _assembly(result: Result) -> list[_Drawing]:
    most = max(max(trial["attempts"]) for trial in result.trials)
    cap = max(result.config.get("task", {}).get("max_attempts", most), most)
    return [
        (
            "success",
            "Share of all pegs that the robot inserted within that many attempts at the peg; bands are 95 % "
            "intervals by bootstrap over trials.",
            lambda: figures.success_curve(result.trials, cap),
        ),
        (
            "interventions",
            f"Share of all pegs that a human had to insert after {cap} attempts, with 95 % intervals by "
            "bootstrap over trials; where it was none or every peg, Wilson's for that many trials: wide.",
            lambda: figures.intervention_rate(result.summary),
        ),
        (
            "attempts",
            "Attempts that the first n pegs took together, as in the paper: areas are shares of the trials, "
            f"vertical lines the methods' means; a peg given to a human counts {cap}.",
            lambda: figures.attempts_histogram(result.trials),
        ),
    ]


def _attempt(result: Result) -> list[_Drawing]:
    kind = result.config.get("detector", {}).get("kind", "unknown")
    drawings: list[_Drawing] = [
        (
            "success",
            f"Success of single attempts by pair, detector “{kind}”, with Wilson 95 % intervals; the paper's "
            "rate is of matched pairs, and its figures look like the detector “disc”.",
            lambda: figures.attempt_success(result.summary),
        )
    ]
    matched = [trial for trial in result.trials if trial["matched"]]
    if matched:
        caption = (
            "Success of matched attempts by the error of the estimate over which they start, with Wilson "
            f"95 % intervals in bins of {figures.ERROR_BIN_MM:g} mm."
        )
        drawings.append(("error", caption, lambda: figures.success_by_error(matched)))
    return drawings


def _by_attempt(result: Result) -> list[_Drawing]:
    return [
        (
            "attempts",
            "Mean distance of the believed from the true position after each failed attempt at a hole, of "
            "those that came so far, with 95 % intervals by bootstrap over holes.",
            lambda: calibration_figures.error_by_attempt(result.summary),
        ),
        (
            "coverage-by-attempt",
            "Share of the true positions inside the ellipses of 50 and 90 % after each failed attempt, with "
            "95 % intervals by bootstrap over holes: below the dashed line the belief is too sure.",
            lambda: calibration_figures.coverage_by_attempt(result.summary),
        ),
    ]


def _calibration(result: Result) -> list[_Drawing]:
    actions = max(trial["actions"] for trial in result.trials)
    whole = [trial for trial in result.trials if trial["actions"] == actions]
    several = [] if {trial["attempt"] for trial in whole} == {1} else _by_attempt(result)
    return [
        *several,
        (
            "actions",
            "Mean distance of the believed from the true position after one failed attempt, by how much of "
            "it is read, with 95 % intervals by bootstrap over holes.",
            lambda: calibration_figures.error_by_actions(result.summary),
        ),
        (
            "coverage",
            "Share of the true positions inside the belief's ellipse, by the ellipse's probability: on the "
            "dashed line the belief is honest, below it too sure.",
            lambda: calibration_figures.coverage(whole),
        ),
        (
            "reliability",
            "How often peg and hole match, by the probability given to it, with 95 % intervals.",
            lambda: calibration_figures.match_reliability(whole),
        ),
        (
            "pairs",
            "How well one failed attempt tells a peg's own hole from another: area under the ROC curve with "
            "95 % intervals by bootstrap over holes; 0.5 is chance.",
            lambda: calibration_figures.match_by_pair(result.summary),
        ),
    ]


def _pictures(slug: str, drawings: list[_Drawing]) -> tuple[Picture, ...]:
    return tuple(picture(f"{slug}-{name}", caption, draw) for name, caption, draw in drawings)


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


def _json_of(path: Path) -> dict[str, Any]:
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}  # facts beside the figures: a run of another making may lack them
    return tree if isinstance(tree, dict) else {}
