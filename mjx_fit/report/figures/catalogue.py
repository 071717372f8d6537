"""Which figures an experiment has: a name, a sentence, and how it is drawn."""

from collections.abc import Callable

from matplotlib.figure import Figure

from mjx_fit.config.schema import config_from_tree
from mjx_fit.evaluation.results import Result
from mjx_fit.report import paper_values
from mjx_fit.report.figures import assembly, calibration, single_hole

Drawing = tuple[str, str, Callable[[], Figure]]


def of_result(result: Result) -> list[Drawing]:
    """The figures of a result; an experiment that has none of its own, or no trials, has its table."""
    kinds = {
        "assembly": _assembly,
        "attempt": _attempt,
        "calibration": _calibration,
        "insertion": _insertion,
        "position": _position,
    }
    if not result.trials or result.experiment not in kinds:
        return []
    return kinds[result.experiment](result)


def _assembly(result: Result) -> list[Drawing]:
    most = max(max(trial["attempts"]) for trial in result.trials)
    cap = max(result.config.get("task", {}).get("max_attempts", most), most)
    shown: list[Drawing] = [
        (
            "success",
            "Share of all pegs that the robot inserted within that many attempts at the peg; bands are 95 % "
            "intervals by bootstrap over trials.",
            lambda: assembly.success_curve(result.trials, cap),
        ),
        (
            "attempts",
            "Attempts that the first n pegs took together, as in the paper: areas are shares of the trials, "
            f"vertical lines the methods' means; a peg given to a human counts {cap}.",
            lambda: assembly.attempts_histogram(result.trials),
        ),
    ]
    if any((row.metric, row.group) == ("intervention_rate", "all") for row in result.summary):
        caption = (
            f"Share of all pegs that a human had to insert after {cap} attempts, with 95 % intervals by "
            "bootstrap over trials; where it was none or every peg, Wilson's for that many trials: wide."
        )
        beside = paper_values.beside(result.config)
        drawing = ("interventions", caption, lambda: assembly.intervention_rate(result.summary, beside))
        shown.insert(1, drawing)
    if all("tried" in trial and "holes" in trial for trial in result.trials):
        caption = "What the attempts of an assembly were spent on, on average over the trials."
        shown.append(("spent", caption, lambda: assembly.where_attempts_went(result.trials)))
    if any(row.metric == "attempts_ratio" for row in result.summary):
        caption = (
            "Attempts of full for all pegs over those of each other method in the same trials, with 95 % "
            "intervals by bootstrap over trials: left of the dashed line full needs fewer."
        )
        shown.append(("ratio", caption, lambda: assembly.attempts_ratio(result.summary)))
    return shown


def _attempt(result: Result) -> list[Drawing]:
    kind = result.config.get("detector", {}).get("kind", "unknown")
    drawings: list[Drawing] = []
    if any(row.metric == "success_rate" for row in result.summary):
        caption = (
            f"Success of single attempts by pair, detector “{kind}”, with Wilson 95 % intervals; the paper's "
            "rate is of matched pairs, and its figures look like the detector “disc”."
        )
        drawings.append(("success", caption, lambda: assembly.attempt_success(result.summary)))
    matched = [trial for trial in result.trials if trial["matched"]]
    if matched:
        caption = (
            "Success of matched attempts by the error of the estimate over which they start, with Wilson "
            f"95 % intervals in bins of {assembly.ERROR_BIN_MM:g} mm."
        )
        drawings.append(("error", caption, lambda: assembly.success_by_error(matched)))
    return drawings


def _by_attempt(result: Result) -> list[Drawing]:
    return [
        (
            "attempts",
            "Mean distance of the believed from the true position after each failed attempt at a hole, of "
            "those that came so far, with 95 % intervals by bootstrap over holes.",
            lambda: calibration.error_by_attempt(result.summary),
        ),
        (
            "coverage-by-attempt",
            "Share of the true positions inside the ellipses of 50 and 90 % after each failed attempt, with "
            "95 % intervals by bootstrap over holes: below the dashed line the belief is too sure.",
            lambda: calibration.coverage_by_attempt(result.summary),
        ),
    ]


def _calibration(result: Result) -> list[Drawing]:
    actions = max(trial["actions"] for trial in result.trials)
    whole = [trial for trial in result.trials if trial["actions"] == actions]
    # Only a set whose attempts start from this sensor's own beliefs tells what it makes of several.
    own = result.request.get("beliefs_of") == result.request.get("sensor", {}).get("full", "-")
    several = _by_attempt(result) if own else []
    names = config_from_tree(result.config).scene.names
    return [
        *several,
        (
            "actions",
            "Mean distance of the believed from the true position after one failed attempt, by how much of "
            "it is read, with 95 % intervals by bootstrap over holes.",
            lambda: calibration.error_by_actions(result.summary),
        ),
        (
            "coverage",
            "Share of the true positions inside the belief's ellipse, by the ellipse's probability: on the "
            "dashed line the belief is honest, below it too sure.",
            lambda: calibration.coverage(whole),
        ),
        (
            "reliability",
            "How often peg and hole match, by the probability given to it, with 95 % intervals.",
            lambda: calibration.match_reliability(whole, names),
        ),
        *_by_pair(result, len(names)),
    ]


def _by_pair(result: Result, n_types: int) -> list[Drawing]:
    if n_types == 1:
        return []
    caption = (
        "How well one failed attempt tells a peg's own hole from another: area under the ROC curve with "
        "95 % intervals by bootstrap over holes; 0.5 is chance."
    )
    return [("pairs", caption, lambda: calibration.match_by_pair(result.summary))]


def _position(result: Result) -> list[Drawing]:
    summary = result.summary
    mismatched: list[Drawing] = [
        (
            "error",
            "Mean distance of the believed from the true position before the first and after each attempt, "
            "at holes that do not match the peg, so that every trial has all attempts; the paper's figure, "
            "with 95 % intervals by bootstrap over trials.",
            lambda: single_hole.error_by_attempt(summary),
        ),
    ]
    spread: list[Drawing] = [
        (
            "error-spread",
            "How the errors of mismatched trials are spread: median (dot), middle half (bar), middle 90 % "
            "(line).",
            lambda: single_hole.errors_spread(result.trials),
        ),
    ]
    if all(trial["pair"][0] == trial["pair"][1] for trial in result.trials):
        mismatched, spread = [], []
    return [
        *mismatched,
        (
            "error-matched",
            "Mean distance of the believed from the true position after each attempt, at holes that match: "
            "the belief stays as it is once the peg is in.",
            lambda: single_hole.error_by_attempt(summary, "matched:"),
        ),
        *spread,
        (
            "coverage",
            "Share of the true positions inside the belief's 90 % ellipse, of the trials whose peg is not in "
            "yet: below the dashed line the belief is too sure.",
            lambda: single_hole.coverage_by_attempt(summary),
        ),
    ]


def _insertion(result: Result) -> list[Drawing]:
    shown: list[Drawing] = [
        (
            "success",
            "Share of the pegs that are in their hole within so many attempts; the paper's figure, with 95 % "
            "intervals by bootstrap over draws, Wilson's where it is all or none.",
            lambda: single_hole.success_by_attempts(result.summary),
        )
    ]
    if any(row.metric == "attempts_saved" for row in result.summary):
        caption = (
            "How many attempts fewer full needs than another method in the same trial, on average, with 95 % "
            "intervals by bootstrap over draws; p by a sign-flip test, adjusted by Holm."
        )
        shown.append(("saved", caption, lambda: single_hole.attempts_saved(result.summary)))
    return shown
