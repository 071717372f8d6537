"""Compare insertion results of the same draws: seconds, newtons, and paired tests against the first.

    python experiments/gentle/compare.py OUT NAME=FILE.json:METHOD NAME=FILE.json:METHOD ...

Writes OUT.json, OUT_seconds.png and OUT_forces.png. A trial without an insertion counts with the seconds of
all its attempts. The tests are sign flips of paired seconds, whole draws at a time, with Holm's adjustment.
"""

import argparse
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mjx_fit.config.schema import config_from_stored
from mjx_fit.evaluation import results
from mjx_fit.evaluation.effort_summary import summarise_effort, totals
from mjx_fit.evaluation.statistics import bootstrap_mean, holm, sign_flip
from mjx_fit.report import script
from mjx_fit.report.figures.effort import inserted_by_seconds, peak_forces

METRICS = ("seconds", "in_by_5s", "in_by_10s", "in_by_30s", "peak_force_n", "mean_force_n", "over_20n_share",
           "move_seconds")  # fmt: skip

HEAD = (
    "method", "seconds, median", "mean", "in by 5 / 10 / 30 s", "largest force, median", "mean force",
    "over 20 N, 99 % of trials below", "visits", "p",
)  # fmt: skip


def main(out: Path, sources: list[str]) -> None:
    rows: list[dict[str, Any]] = []
    table, drawn = {}, []
    for source in sources:
        name, _, place = source.partition("=")
        file, _, method = place.rpartition(":")
        result = results.read(Path(file))
        drawn.append((result.seed, config_from_stored(result.config).detector))
        own = [row for row in result.trials if row["method"] == method]
        own = sorted(own, key=lambda row: (row["trial"], row["seed"]))
        rows += [row | {"method": name} for row in own]
        table[name] = described(own)
    by_name = results.by_method(rows)
    first, *others = by_name
    draws = [row["trial"] for row in by_name[first]]
    seconds = {name: totals(own, "seconds") for name, own in by_name.items()}
    require_same_draws(drawn, by_name)
    saved = {name: seconds[name] - seconds[first] for name in others}
    p_values = holm([sign_flip(one, draws) for one in saved.values()])
    for (name, one), p_value in zip(saved.items(), p_values, strict=True):
        mean = bootstrap_mean(one, draws)
        table[name] |= {"saves_seconds": [mean.value, mean.low, mean.high], "p_value": p_value}
    script.save(out.with_suffix(".json"), {"sources": sources, "n": len(draws), "methods": table})
    print_table(table)
    for kind, drawn in (("seconds", inserted_by_seconds), ("forces", peak_forces)):
        script.draw(out.with_name(f"{out.name}_{kind}.png"), partial(drawn, rows))


def require_same_draws(drawn: list[Any], by_name: dict[str, list[dict[str, Any]]]) -> None:
    """Stop if trials, or root seeds and detectors, of the results differ."""
    trials = [[(row["trial"], row["seed"]) for row in own] for own in by_name.values()]
    if drawn != drawn[:1] * len(drawn) or trials != trials[:1] * len(trials):
        raise SystemExit("the results are of other draws")


def print_table(table: dict[str, Any]) -> None:
    """Print one row of Markdown for each method."""
    print("| " + " | ".join(HEAD) + " |\n|" + "---|" * len(HEAD))
    for name, own in table.items():
        shares = " / ".join(f"{100 * own[f'in_by_{limit}s'][0]:.1f}" for limit in (5, 10, 30))
        median = own.get("seconds median")
        cells = [
            name,
            "-" if median is None else f"{median[0]:.1f} ({median[1]:.1f} to {median[2]:.1f})",
            "{:.1f} ({:.1f} to {:.1f})".format(*own["seconds"]),
            f"{shares} %",
            f"{own['peak_force_n median'][0]:.1f} N",
            f"{own['mean_force_n'][0]:.1f} N",
            f"{own['over_20n_s_99th']:.2f} s",
            f"{own['visits']:.2f}",
            f"{own['p_value']:.1g}" if "p_value" in own else "",
        ]
        print("| " + " | ".join(cells) + " |")


def described(own: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the metrics of one method: value, and the ends of its interval."""
    summary = summarise_effort("", own, success=[row["success"] for row in own])
    found = {
        f"{row.metric}{'' if row.group == 'all' else ' ' + row.group}": [row.value, row.low, row.high]
        for row in summary
        if row.metric in METRICS
    }
    visits = np.array([row["attempts"] for row in own])
    peaks = totals(own, "over_20n_s")
    return found | {
        "success": float(np.mean([row["success"] for row in own])),
        "visits": float(visits.mean()),
        "over_20n_s_99th": float(np.quantile(peaks, 0.99)),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("sources", nargs="+", metavar="NAME=FILE.json:METHOD")
    asked = parser.parse_args()
    main(asked.out, asked.sources)
