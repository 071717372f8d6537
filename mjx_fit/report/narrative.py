"""Single assemblies, attempt by attempt: the hole chosen and why, peak force, outcome and posterior."""

from dataclasses import dataclass
from typing import Any

from mjx_fit.evaluation.results import Result, by_method

TOLD = "full"
"""Method whose assemblies are narrated; the first method of a result that lacks it."""


@dataclass(frozen=True)
class Story:
    """One assembly in words.

    Attributes:
        title: Which assembly it is.
        pegs: Heading and attempts of each peg; an attempt is a row of cells as in ``COLUMNS``.
        hardest: True for the assembly with the most attempts.
    """

    title: str
    pegs: tuple[tuple[str, tuple[tuple[str, ...], ...]], ...]
    hardest: bool = False


RULE = (
    "Each attempt goes to the empty hole with the highest P(success) under the current belief: P(match), the "
    "probability that peg and hole match, times the success rate of an attempt at a matching hole. Ties go "
    "to the hole that was tried least with this peg."
)
COLUMNS = (
    "hole",
    "P(match)",
    "P(success)",
    "P(success), next best hole",
    "position error",
    "time",
    "peak force",
    "outcome",
    "P(match) after",
    "position error after",
)


def of_result(result: Result) -> tuple[Story, ...]:
    """Return the stories of a median and the hardest assembly; none if the attempts were not stored."""
    if result.experiment != "assembly" or not result.trials:
        return ()
    methods = by_method(result.trials)
    own = methods.get(TOLD, next(iter(methods.values())))
    needed = {"tried", "holes", "match_probability", "error_cm", "match_after", "error_after_cm"}
    whole = [trial for trial in own if needed <= trial.keys()]
    if not whole:
        return ()
    ranked = sorted(whole, key=lambda trial: (sum(trial["attempts"]), trial["trial"]))
    picked = {"median": ranked[(len(ranked) - 1) // 2], "hardest": ranked[-1]}
    if picked["median"] is picked["hardest"]:
        del picked["median"]
    return tuple(_story(word, len(ranked), trial) for word, trial in picked.items())


def _story(rank: str, n_trials: int, trial: dict[str, Any]) -> Story:
    total = sum(trial["attempts"])
    pegs = []
    for number, (peg, tried, human) in enumerate(
        zip(trial["pegs"], trial["tried"], trial["human"], strict=True)
    ):
        n = _attempts(len(tried))
        ending = f"human intervention after {n}" if human else f"inserted after {n}"
        ending += ", in a hole of another type" if _wrongly(trial, number) else ""
        rows = tuple(_row(trial, number, attempt) for attempt in range(len(tried)))
        pegs.append((f"Peg {number + 1}, a {peg}: {ending}", rows))
    method = trial["method"].replace("_", " ")
    title = f"{rank.capitalize()} of {n_trials} assemblies with {method}: trial {trial['trial']}"
    return Story(f"{title}, {_attempts(total)}", tuple(pegs), rank == "hardest")


def _row(trial: dict[str, Any], peg: int, attempt: int) -> tuple[str, ...]:
    def told(column: str) -> Any:
        return trial[column][peg][attempt]

    def told_if(column: str) -> Any:
        given = trial.get(column, [[]])
        return given[peg][attempt] if len(given) > peg and len(given[peg]) > attempt else None

    hole, seconds, force = told("tried"), told_if("seconds"), told_if("peak_force_n")
    last = attempt == len(trial["tried"][peg]) - 1
    inserted = last and not trial["human"][peg]
    return (
        f"{hole + 1} ({trial['holes'][hole]})",
        f"{told('match_probability'):.0%}",
        *(_share(told(column) if column in trial else None) for column in ("chance", "next_best")),
        f"{10 * told('error_cm'):.1f} mm",
        "-" if seconds is None else f"{seconds:.1f} s",
        "-" if force is None else f"{force:.0f} N",
        "inserted wrongly" if inserted and _wrongly(trial, peg) else "inserted" if inserted else "failed",
        "" if inserted else f"{told('match_after'):.0%}",
        "" if inserted else f"{10 * told('error_after_cm'):.1f} mm",
    )


def _wrongly(trial: dict[str, Any], peg: int) -> bool:
    return trial.get("inserted_wrongly", [False] * (peg + 1))[peg]


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.1%}"


def _attempts(n: int) -> str:
    return f"{n} attempt" + ("s" if n != 1 else "")
