"""Sections of training runs in a report."""

from dataclasses import replace
from functools import partial
from pathlib import Path

from mjx_fit.report.figures import training_run
from mjx_fit.report.sections import Section, json_of, pictures_of, provenance, text_of

_COMPARED = (
    "All training runs of this page: negative log-likelihood of the true hole state in validation, by epoch; "
    "lower is better. Runs can be compared that validate on the same data."
)


def of_run(slug: str, folder: Path) -> Section:
    """Return the section of a training run."""
    metrics = training_run.read_metrics(folder / "metrics.jsonl")
    caption = (
        "Negative log-likelihood of the true hole state under the posterior, by epoch, and under the prior "
        "(dashed); lower is better."
    )
    pictures = pictures_of(slug, [("training", caption, lambda: training_run.training_curve(metrics))])
    facts = (("epochs", str(len(metrics))), *provenance(json_of(folder / "run.json")))
    config = text_of(folder / "config.yaml")
    title = f"Training: {folder.resolve().name}"
    return Section(slug, title, facts, config, (), pictures, kind="training run", epochs=tuple(metrics))


def with_comparison(made: list[Section]) -> list[Section]:
    """Add a figure of all runs to the first one, if there are several."""
    runs = {section.slug: section.epochs for section in made if section.epochs}
    if len(runs) < 2:
        return made
    first = next(iter(runs))
    drawn = pictures_of(first, [("compared", _COMPARED, partial(training_run.training_curves, runs))])
    return [
        replace(section, pictures=(*section.pictures, *drawn)) if section.slug == first else section
        for section in made
    ]
