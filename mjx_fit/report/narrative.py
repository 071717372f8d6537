"""Single assemblies, attempt by attempt: the hole and why it, what was felt, what was believed then."""

from dataclasses import dataclass
from typing import Any

from mjx_fit.evaluation.results import Result, by_method

TOLD = "full"
"""The method whose assemblies are told, or the first of a result that lacks it."""


@dataclass(frozen=True)
class Story:
    """One assembly in words.

    Attributes:
        title: Which one.
        pegs: For each peg a heading and its attempts, a row of cells each as in ``COLUMNS``.
    """

    title: str
    pegs: tuple[tuple[str, tuple[tuple[str, ...], ...]], ...]


RULE = (
    "Each attempt goes to the empty hole where it is most likely to succeed, as far as is believed: the "
    "probability that peg and hole match, times how often an attempt succeeds when they do. Among equals it "
    "goes to the hole that was tried least with this peg."
)
COLUMNS = (
    "hole",
    "believed to match",
    "chance of success",
    "at the next best",
    "estimate off by",
    "felt at most",
    "and",
    "then believed to match",
    "estimate off by",
)


def of_result(result: Result) -> tuple[Story, ...]:
    """The stories of a usual assembly and of the hardest one; none where the attempts were not kept."""
    if result.experiment != "assembly" or not result.trials:
        return ()
    methods = by_method(result.trials)
    own = methods.get(TOLD, next(iter(methods.values())))
    needed = {"tried", "holes", "match_probability", "error_cm", "match_after", "error_after_cm"}
    whole = [trial for trial in own if needed <= trial.keys()]
    if not whole:
        return ()
    ranked = sorted(whole, key=lambda trial: (sum(trial["attempts"]), trial["trial"]))
    picked = {"usual": ranked[(len(ranked) - 1) // 2], "hardest": ranked[-1]}
    if picked["usual"] is picked["hardest"]:
        del picked["usual"]
    return tuple(_story(f"The {word} assembly of {len(ranked)}", trial) for word, trial in picked.items())


def _story(words: str, trial: dict[str, Any]) -> Story:
    total = sum(trial["attempts"])
    pegs = []
    for number, (peg, tried, human) in enumerate(
        zip(trial["pegs"], trial["tried"], trial["human"], strict=True)
    ):
        ending = f"not in after {len(tried)}: a human helps" if human else f"in after {_attempts(len(tried))}"
        ending += ", in a hole of another type" if _wrongly(trial, number) else ""
        rows = tuple(_row(trial, number, attempt) for attempt in range(len(tried)))
        pegs.append((f"Peg {number + 1}, a {peg}: {ending}", rows))
    title = f"{words} under {trial['method'].replace('_', ' ')}: trial {trial['trial']}, {_attempts(total)}"
    return Story(title, tuple(pegs))


def _row(trial: dict[str, Any], peg: int, attempt: int) -> tuple[str, ...]:
    def told(column: str) -> Any:
        return trial[column][peg][attempt]

    hole, force = told("tried"), trial.get("peak_force_n", [[]])
    felt = force[peg][attempt] if len(force) > peg and len(force[peg]) > attempt else None
    last = attempt == len(trial["tried"][peg]) - 1
    inserted = last and not trial["human"][peg]
    return (
        f"{hole + 1} ({trial['holes'][hole]})",
        f"{told('match_probability'):.0%}",
        *(_share(told(column) if column in trial else None) for column in ("chance", "next_best")),
        f"{10 * told('error_cm'):.1f} mm",
        "-" if felt is None else f"{felt:.0f} N",
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
