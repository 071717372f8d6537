"""Opening of a page: one sentence on its content, and a legend of the marks in tables and figures."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from mjx_fit.report.figures.style import MATCHED_COLOUR, MISMATCHED_COLOUR
from mjx_fit.report.sections import Section
from mjx_fit.utils.type_colours import FIGURE_COLOURS

_OTHERS = ("data set", "training run", "video")
"""Kinds of sections that are not experiments."""
_BY_PAIR = ("attempt", "data set")
"""Kinds of sections with figures in the colours of matched and mismatched pairs."""


@dataclass(frozen=True)
class Mark:
    """One entry of the legend.

    Attributes:
        sign: The mark, in words.
        meaning: Its meaning.
        colours: Colours that it stands for, as CSS; empty if it has none.
    """

    sign: str
    meaning: str
    colours: tuple[str, ...] = ()


def lead(sections: Sequence[Section]) -> str:
    """Return the sentence that says what the page shows."""
    experiments = list(dict.fromkeys(one.kind for one in sections if one.kind not in _OTHERS))
    n_experiments = sum(one.kind not in _OTHERS for one in sections)
    shown = [f"{_counted(n_experiments, 'experiment')} ({', '.join(experiments)})"] if experiments else []
    counts = Counter(one.kind for one in sections)
    shown += [_counted(counts[kind], kind) for kind in _OTHERS if counts[kind]]
    listed = " and ".join(part for part in (", ".join(shown[:-1]), shown[-1] if shown else "") if part)
    return (
        "A simulated robot arm inserts pegs into holes whose position and type are uncertain, and learns "
        f"from the contact forces of failed attempts; this page shows {listed}."
    )


def marks(sections: Sequence[Section]) -> list[Mark]:
    """Return the entries of the legend that apply to the sections of a page."""
    rows = [row for one in sections for row in one.rows]
    found = []
    if rows:
        found += [
            Mark("value [low, high]", "estimate with its 95 % interval; n is the number of trials or pegs"),
            Mark("bars, bands", "95 % interval of a point or a line, unless the caption says otherwise"),
            Mark("dashed line", "reference, named in the legend or the caption of the figure"),
            Mark("line colour, marker", "method, named above each figure"),
        ]
    if any(one.kind in _BY_PAIR for one in sections):
        found.append(Mark("matched, mismatched", _PAIRS, (MATCHED_COLOUR, MISMATCHED_COLOUR)))
    if any((row.method, row.metric, row.group) in one.paper for one in sections for row in one.rows):
        found.append(Mark("paper, ◇", "value reported by the paper, arXiv 2101.02725"))
    for names in dict.fromkeys(one.types for one in sections if one.types):
        colours = FIGURE_COLOURS[: len(names)]
        found.append(
            Mark("types", f"{', '.join(names)}: colour of a type in the data set's figures", colours)
        )
    if any(one.video for one in sections):
        found.append(Mark("video", _VIDEO))
    return found


_PAIRS = "pegs at holes of their own type and of another type, in figures by pair"
_VIDEO = (
    "pegs have the colour of their type; the disc over a hole is the 90 % region of its estimated position"
)


def _counted(n: int, word: str) -> str:
    return f"{n} {word}" + ("s" if n != 1 else "")
