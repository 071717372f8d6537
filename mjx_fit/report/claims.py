"""Claims in words, computed from the summary of a result: each number with its 95 % interval."""

from collections.abc import Callable

from mjx_fit.evaluation.results import Result, number_in
from mjx_fit.evaluation.statistics import Row

MAIN = "full"
"""Method that the claims are about; the first method of a result that lacks it."""
_NUMBERS = ("zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")

_PLURALS = {"trial": "trials", "assembly": "assemblies"}

_Rows = dict[tuple[str, str, str], Row]


def of_result(result: Result) -> tuple[str, ...]:
    """Return the claims that the summary supports, the main one first; none without intervals.

    A comparison uses the paired interval of the summary (a ratio or a difference over the same trials) if it
    has one, and otherwise requires that the intervals of the two methods do not overlap. A comparison that
    shows no difference says so.
    """
    kinds: dict[str, Callable[[_Rows], list[str]]] = {
        "assembly": _assembly,
        "insertion": _insertion,
        "position": _position,
    }
    bounded = (row for row in result.summary if row.low is not None and row.high is not None)
    rows = {(row.method, row.metric, row.group): row for row in bounded}
    return tuple(kinds[result.experiment](rows)) if result.experiment in kinds else ()


def _assembly(rows: _Rows) -> list[str]:
    mean = _by_method(rows, "attempts", "all")
    if not mean:
        return []
    main = _main(mean)
    pegs = _last_number(rows, main.method, "attempts")
    claim = f"{main.method} needs {main.value:.1f} attempts on average for {_pegs(pegs)} "
    claim += f"(95 % interval {_ends(main, '.1f')}; n = {main.n})"
    claims = [f"{claim}{_interventions(rows, main.method)}.", *_effort(rows, main.method, "assembly")]
    for other in mean.values():
        if other is not main:
            ratio = rows.get((main.method, "attempts_ratio", other.method))
            claim = _comparison(main, other, _side(ratio, 1) if ratio else _apart(main, other), "attempts")
            claim += f", ratio {ratio.value:.3g} ({_ends(ratio, '.3g')})" if ratio else ""
            claims.append(f"{claim}{_interventions(rows, other.method)}.")
    return claims


def _insertion(rows: _Rows) -> list[str]:
    mean = _by_method(rows, "attempts", "all")
    if not mean:
        return []
    main = _main(mean)
    cap = _last_number(rows, main.method, "success_rate")
    claim = f"{main.method} needs {main.value:.2f} attempts on average at a matching hole "
    claim += f"(95 % interval {_ends(main, '.2f')}; n = {main.n})"
    rate = rows.get((main.method, "success_rate", str(cap)))
    if rate:
        claim += f" and inserts {_share(rate)} of the pegs within {cap} attempts"
    claims = [f"{claim}.", *_effort(rows, main.method, "trial")]
    for other in mean.values():
        if other is not main:
            saved = rows.get((main.method, "attempts_saved", other.method))
            claim = _comparison(main, other, -_side(saved, 0) if saved else _apart(main, other), "attempts")
            claim += f", {saved.value:.2f} saved ({_ends(saved, '.2f')})" if saved else ""
            claims.append(f"{claim}.")
    return claims


def _position(rows: _Rows) -> list[str]:
    """Claim the error before and after the attempts at mismatched holes, or at matching ones."""
    for prefix, holes in (("", "mismatched holes"), ("matched:", "matching holes")):
        before = _by_method(rows, "position_error_cm", f"{prefix}0")
        if not before:
            continue
        main = _main(before)
        cap = _last_number(rows, main.method, "position_error_cm", prefix)
        after = _by_method(rows, "position_error_cm", f"{prefix}{cap}")
        if not cap or main.method not in after:
            continue
        end = after[main.method]
        verb = {-1: "reduces", 1: "increases"}.get(_apart(end, main))
        numbers = f"{main.value:.3g} cm (95 % interval {_ends(main, '.3g')}) to {end.value:.3g} cm "
        numbers += f"({_ends(end, '.3g')}) in {_counted(cap, 'attempt')} at {holes} (n = {end.n})"
        unchanged = f"{main.method} shows no change of the mean position error, from {numbers}."
        claims = [f"{main.method} {verb} the mean position error from {numbers}." if verb else unchanged]
        others = [row for name, row in after.items() if name not in (main.method, "oracle")]
        return claims + [f"{_comparison(end, other, _apart(end, other), 'cm')}." for other in others]
    return []


def _effort(rows: _Rows, method: str, trial: str) -> list[str]:
    """Claim the seconds of a trial and its largest force."""
    seconds, force = (rows.get((method, metric, "all")) for metric in ("seconds", "peak_force_n"))
    in_time, hard = (rows.get((method, metric, "all")) for metric in ("in_by_10s", "over_20n_share"))
    if not (seconds and force and in_time and hard):
        return []
    return [
        f"The attempts of {method} take {seconds.value:.1f} s per {trial} ({_ends(seconds, '.1f')}); "
        f"{_share(in_time)} of the pegs are in within 10 s. The largest force averages {force.value:.1f} N "
        f"({_ends(force, '.1f')}); {_share(hard)} of the {_PLURALS[trial]} exceed 20 N for more than 0.1 s."
    ]


def _comparison(main: Row, other: Row, side: int, unit: str) -> str:
    """Compare two methods in words.

    Args:
        main: Mean of the method that the claim is about.
        other: Mean of the other method.
        side: -1 if the intervals show less, 1 if they show more, 0 if they show no difference.
        unit: Unit of the numbers, ``attempts`` or ``cm``.
    """
    digits = ".3g" if unit == "cm" else ".2f" if min(main.value, other.value) < 3 else ".1f"
    difference, numbers = main.value - other.value, f"{other.value:{digits}} ({_ends(other, digits)})"
    if difference * side <= 0:  # a paired interval over fewer trials may also point to the other side
        return f"No difference from {other.method} is shown: {numbers}"
    word = "more" if side > 0 else "less" if unit == "cm" else "fewer"
    return f"{abs(difference):{digits}} {unit} {word} than {other.method}: {numbers}"


def _apart(one: Row, other: Row) -> int:
    """Return -1 or 1 if the interval of ``one`` lies below or above that of the other, 0 if they overlap."""
    (low, high), (other_low, other_high) = _bounds(one), _bounds(other)
    return (low > other_high) - (high < other_low)


def _side(row: Row, equal: float) -> int:
    """Return -1 or 1 if the interval lies below or above a value, 0 if it contains it."""
    low, high = _bounds(row)
    return (low > equal) - (high < equal)


def _bounds(row: Row) -> tuple[float, float]:
    assert row.low is not None  # rows without an interval are left out
    assert row.high is not None
    return row.low, row.high


def _interventions(rows: _Rows, method: str) -> str:
    rate = rows.get((method, "intervention_rate", "all"))
    return f", with human intervention for {_share(rate)} of the pegs" if rate else ""


def _by_method(rows: _Rows, metric: str, group: str) -> dict[str, Row]:
    return {row.method: row for row in rows.values() if (row.metric, row.group) == (metric, group)}


def _main(found: dict[str, Row]) -> Row:
    return found.get(MAIN) or next(iter(found.values()))


def _last_number(rows: _Rows, method: str, metric: str, prefix: str = "") -> int:
    """Return the largest number among the groups of a metric; 0 if none has one."""
    own = (row.group for row in rows.values() if (row.method, row.metric) == (method, metric))
    return max((number for group in own if (number := number_in(group, prefix)) is not None), default=0)


def _pegs(n: int) -> str:
    return _counted(n, "peg") if n else "all pegs"


def _counted(n: int, word: str) -> str:
    number = _NUMBERS[n] if n < len(_NUMBERS) else str(n)
    return f"{number} {word}" + ("s" if n != 1 else "")


def _ends(row: Row, digits: str) -> str:
    return f"{row.low:{digits}} to {row.high:{digits}}"


def _share(row: Row) -> str:
    return f"{row.value:.1%} ({row.low:.1%} to {row.high:.1%})"
