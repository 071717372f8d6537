"""Figures of each experiment: name, caption and drawing function."""

from collections.abc import Callable

from matplotlib.figure import Figure

from mjx_fit.config.schema import config_from_stored
from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.sweep import MAIN
from mjx_fit.report import paper_values
from mjx_fit.report.figures import assembly, calibration, effort, robustness, single_hole, sweep

Drawing = tuple[str, str, Callable[[], Figure]]


def of_result(result: Result) -> list[Drawing]:
    """Return the figures of a result; empty for unknown experiments and results without trials."""
    kinds = {
        "assembly": _assembly,
        "attempt": _attempt,
        "calibration": _calibration,
        "insertion": _insertion,
        "position": _position,
        "robustness": _robustness,
        "sweep": _sweep,
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
            "Insertion rate within k attempts at a peg, over all pegs; bands are 95 % intervals by bootstrap "
            "over trials.",
            lambda: assembly.success_curve(result.trials, cap),
        ),
        (
            "attempts",
            "Cumulative attempts for the first n pegs, as in the paper: histograms over trials, with means "
            f"as vertical lines; a peg with human intervention counts {cap} attempts.",
            lambda: assembly.attempts_histogram(result.trials),
        ),
    ]
    if any((row.metric, row.group) == ("intervention_rate", "all") for row in result.summary):
        caption = (
            f"Human intervention rate: share of all pegs inserted by a human after {cap} attempts, with 95 % "
            "intervals by bootstrap over trials; wider Wilson intervals over trials for rates of 0 and 1."
        )
        beside = paper_values.beside(result.config)
        drawing = ("interventions", caption, lambda: assembly.intervention_rate(result.summary, beside))
        shown.insert(1, drawing)
    if all("tried" in trial and "holes" in trial for trial in result.trials):
        caption = "Mean number of attempts of an assembly by outcome, over all trials."
        shown.append(("spent", caption, lambda: assembly.where_attempts_went(result.trials)))
    if any(row.metric == "attempts_ratio" for row in result.summary):
        caption = (
            "Ratio of attempts for all pegs, full to each other method, in the same trials, with 95 % "
            "intervals by bootstrap over trials; full needs fewer attempts left of the dashed line."
        )
        shown.append(("ratio", caption, lambda: assembly.attempts_ratio(result.summary)))
    return shown + _effort(result)


def _attempt(result: Result) -> list[Drawing]:
    kind = result.config.get("detector", {}).get("kind", "unknown")
    drawings: list[Drawing] = []
    if any(row.metric == "success_rate" for row in result.summary):
        beside = paper_values.beside(result.config)
        caption = f"Success rate of single attempts by pair, detector “{kind}”, with Wilson 95 % intervals"
        caption += (
            "; the paper's rate is for matched pairs, and its figures suggest the detector “disc”."
            if beside
            else "."
        )
        drawings.append(("success", caption, lambda: assembly.attempt_success(result.summary, beside)))
    matched = [trial for trial in result.trials if trial["matched"]]
    if matched:
        caption = (
            "Success rate of attempts at a matching hole by detection error, in bins of "
            f"{assembly.ERROR_BIN_MM:g} mm with Wilson 95 % intervals."
        )
        drawings.append(("error", caption, lambda: assembly.success_by_error(matched)))
    return drawings


def _by_attempt(result: Result) -> list[Drawing]:
    return [
        (
            "attempts",
            "Mean position error after each failed attempt at a hole, over the holes with that many "
            "attempts, with 95 % intervals by bootstrap over holes.",
            lambda: calibration.error_by_attempt(result.summary),
        ),
        (
            "coverage-by-attempt",
            "Coverage of the 50 and 90 % ellipses of the posterior after each failed attempt, with 95 % "
            "intervals by bootstrap over holes; the posterior is overconfident below the dashed line.",
            lambda: calibration.coverage_by_attempt(result.summary),
        ),
    ]


def _calibration(result: Result) -> list[Drawing]:
    actions = max(trial["actions"] for trial in result.trials)
    whole = [trial for trial in result.trials if trial["actions"] == actions]
    # Several attempts are comparable only if they start from this sensor's own posterior.
    own = result.request.get("beliefs_of") == result.request.get("sensor", {}).get("full", "-")
    several = _by_attempt(result) if own else []
    names = config_from_stored(result.config).scene.names
    return [
        *several,
        (
            "actions",
            "Mean position error after an update from each failed attempt, by the number of actions used, "
            "with 95 % intervals by bootstrap over holes.",
            lambda: calibration.error_by_actions(result.summary),
        ),
        (
            "coverage",
            "Observed coverage of the posterior's ellipses by their probability: the posterior is calibrated "
            "on the dashed line, and overconfident below it.",
            lambda: calibration.coverage(whole),
        ),
        (
            "reliability",
            "Reliability diagram: observed frequency of a match per bin of predicted probability, with 95 % "
            "intervals.",
            lambda: calibration.match_reliability(whole, names),
        ),
        *_by_pair(result, len(names)),
    ]


def _by_pair(result: Result, n_types: int) -> list[Drawing]:
    if n_types == 1:
        return []
    caption = (
        "Match AUROC after an update from each failed attempt, by peg type and mismatched hole type, with "
        "95 % intervals by bootstrap over holes; 0.5 is chance."
    )
    return [("pairs", caption, lambda: calibration.match_by_pair(result.summary))]


def _position(result: Result) -> list[Drawing]:
    summary = result.summary
    mismatched: list[Drawing] = [
        (
            "error",
            "Mean position error before the first attempt and after each, at mismatched holes, where every "
            "trial has all attempts; as in the paper, with 95 % intervals by bootstrap over trials.",
            lambda: single_hole.error_by_attempt(summary),
        ),
    ]
    spread: list[Drawing] = [
        (
            "error-spread",
            "Distribution of the position error at mismatched holes: median (dot), middle 50 % (bar), middle "
            "90 % (line).",
            lambda: single_hole.errors_spread(result.trials),
        ),
    ]
    if all(trial["pair"][0] == trial["pair"][1] for trial in result.trials):
        mismatched, spread = [], []
    return [
        *mismatched,
        (
            "error-matched",
            "Mean position error after each attempt at matching holes; the posterior no longer changes once "
            "the peg is inserted.",
            lambda: single_hole.error_by_attempt(summary, "matched:"),
        ),
        *spread,
        (
            "coverage",
            "Coverage of the posterior's 90 % ellipse, over trials whose peg is not yet inserted; the "
            "posterior is overconfident below the dashed line.",
            lambda: single_hole.coverage_by_attempt(summary),
        ),
    ]


def _insertion(result: Result) -> list[Drawing]:
    shown: list[Drawing] = [
        (
            "success",
            "Insertion rate within k attempts, as in the paper, with 95 % intervals by bootstrap over draws, "
            "or Wilson's for rates of 0 and 1.",
            lambda: single_hole.success_by_attempts(result.summary),
        )
    ]
    if any(row.metric == "attempts_saved" for row in result.summary):
        caption = (
            "Attempts saved by full compared with each other method in the same trials, on average, with 95 "
            "% intervals by bootstrap over draws; p from a sign-flip test with Holm's adjustment."
        )
        shown.append(("saved", caption, lambda: single_hole.attempts_saved(result.summary)))
    return shown + _effort(result)


def _effort(result: Result) -> list[Drawing]:
    if not effort.has_effort(result.trials):
        return []
    return [
        (
            "seconds",
            "Share of pegs that the robot has inserted after a number of seconds of attempts, without the "
            "moves between them; a peg inserted by a human is never in.",
            lambda: effort.inserted_by_seconds(result.trials),
        ),
        (
            "forces",
            "Share of trials whose largest force stays below a force; the dashed line is at 20 N.",
            lambda: effort.peak_forces(result.trials),
        ),
    ]


def _sweep(result: Result) -> list[Drawing]:
    if result.request.get("of") not in MAIN or not result.request.get("cells"):
        return []
    caption = "Main metrics by setting, with 95 % intervals over the trials of all seeds."
    return [("sweep", caption, lambda: sweep.of_sweep(result))]


def _robustness(result: Result) -> list[Drawing]:
    caption = (
        "Mean position error (left) and coverage of the 90 % ellipse (right) after one and five attempts at "
        "the same mismatched holes, by perturbation; bars are 95 % intervals by bootstrap over trials, by "
        "Wilson for rates of 0 and 1; the dashed line is the calibrated coverage."
    )
    return [("perturbations", caption, lambda: robustness.by_perturbation(result.summary))]
