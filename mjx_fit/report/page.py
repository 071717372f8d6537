"""One self-contained HTML page."""

from collections.abc import Mapping, Sequence
from html import escape
from itertools import groupby

from mjx_fit.evaluation.statistics import Row
from mjx_fit.report import legend, narrative
from mjx_fit.report.figures.style import Picture
from mjx_fit.report.narrative import Story
from mjx_fit.report.sections import Section

_CSS = """
body{margin:0;font:16px/1.5 system-ui,sans-serif;color:#1b1b1b;background:#fff}
main{max-width:1120px;margin:0 auto;padding:1rem}
h1{font-size:1.7rem;margin:.5rem 0}
h2{font-size:1.3rem;margin:2.5rem 0 .5rem;border-top:2px solid #ddd;padding-top:1rem;overflow-wrap:anywhere}
nav ul,dl{margin:.5rem 0;padding:0}
nav li{display:inline-block;margin-right:1.2rem}
dl{display:grid;grid-template-columns:max-content 1fr;gap:.1rem 1rem;font-size:.9rem}
dt{color:#555}
dd{margin:0;overflow-wrap:anywhere}
.pictures{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,24rem),1fr));gap:1.5rem;align-items:start}
figure{margin:0;max-width:34rem}
figure svg{display:block;width:100%;height:auto}
figcaption{font-size:.9rem;color:#444}
.table{overflow-x:auto;margin:1rem 0}
table{border-collapse:collapse;font-size:.9rem;font-variant-numeric:tabular-nums}
th,td{padding:.2rem .7rem .2rem 0;text-align:left;vertical-align:top}
th.metric{padding-top:.8rem}
th.number,td.number{text-align:right}
tbody+tbody{border-top:1px solid #e4e4e4}
th.name{font-weight:normal;overflow-wrap:anywhere;min-width:4.5rem}
td span{white-space:nowrap}
.video{display:block;width:100%;max-width:1080px;height:auto;border:1px solid #ddd}
p.lead{font-size:1.1rem;margin:.5rem 0}
ul.claims{padding-left:1.2rem;max-width:62rem}
ul.claims li:first-child{font-weight:600}
.swatch{display:inline-block;width:.8em;height:.8em;margin-right:.35em;border-radius:2px}
p.warning{border-left:4px solid #b25d00;padding:.3rem .8rem;background:#fdf4e7}
details{margin:.8rem 0}
pre{overflow-x:auto;background:#f6f6f6;padding:.8rem;font-size:.8rem}
summary{cursor:pointer}
@media (max-width:600px){dl{display:block}dd{margin:0 0 .4rem}
th,td{padding-right:.5rem}table{font-size:.82rem}}
"""


GENERATOR = '<meta name="generator" content="mjx_fit">'
"""Marks a page of ours, which may be overwritten."""


MOST_ROWS = 400
"""Most rows of a table that is shown unfolded."""


def page(sections: Sequence[Section]) -> str:
    """Return the whole report as HTML."""
    links = "".join(f'<li><a href="#{one.slug}">{escape(one.title)}</a></li>' for one in sections)
    stories = [story for one in sections for story in one.stories]
    unfolded = next((story for story in stories if story.hardest), None)
    body = "\n".join(_section(one, unfolded) for one in sections)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f"{GENERATOR}\n"
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>mjx_fit report</title>\n<style>{_CSS}</style>\n</head>\n<body>\n<main>\n"
        f'<h1>mjx_fit report</h1>\n<p class="lead">{escape(legend.lead(sections))}</p>\n'
        f"<nav><ul>{links}</ul></nav>\n{_legend(sections)}{_mixed(sections)}{body}\n"
        "</main>\n</body>\n</html>\n"
    )


def _legend(sections: Sequence[Section]) -> str:
    """Return the legend of the marks that the page uses."""
    terms = "".join(
        f"<dt>{''.join(map(_swatch, mark.colours))}{escape(mark.sign)}</dt><dd>{escape(mark.meaning)}</dd>"
        for mark in legend.marks(sections)
    )
    return f"<dl>{terms}</dl>\n" if terms else ""


def _swatch(colour: str) -> str:
    return f'<span class="swatch" style="background:{colour}"></span>'


def _mixed(sections: Sequence[Section]) -> str:
    """Return a warning if results were made with different versions."""
    found: dict[str, set[str]] = {}
    for section in sections:
        for library, version in section.versions.items():
            found.setdefault(library, set()).add(version)
    differ = [f"{name} {' and '.join(sorted(them))}" for name, them in found.items() if len(them) > 1]
    if not differ:
        return ""
    told = f"Results made with different versions: {', '.join(differ)}. Compare them with care."
    return f'<p class="warning">{escape(told)}</p>\n'


def _section(section: Section, unfolded: Story | None) -> str:
    facts = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in section.facts)
    parts = [f'<section>\n<h2 id="{section.slug}">{escape(section.title)}</h2>']
    parts += [f"<p>{escape(section.about)}</p>"] if section.about else []
    if section.claims:
        items = "".join(f"<li>{escape(claim)}</li>" for claim in section.claims)
        parts.append(f'<ul class="claims">{items}</ul>')
    parts.append(f"<dl>{facts}</dl>")
    if section.video:
        parts.append(_video(section))
    if section.rows:
        parts.append(_table(section.rows, section.paper))
    if section.pictures:
        parts.append('<div class="pictures">' + "\n".join(map(_figure, section.pictures)) + "</div>")
    parts += [_told(story, story is unfolded) for story in section.stories]
    if section.config:
        parts.append(
            f"<details><summary>Configuration</summary><pre>{escape(section.config)}</pre></details>"
        )
    return "\n".join([*parts, "</section>"])


def _figure(picture: Picture) -> str:
    svg = picture.svg[picture.svg.index("<svg") :]
    svg = svg.replace("<svg", f'<svg role="img" aria-label="{escape(picture.caption)}"', 1)
    return f"<figure>\n{svg}<figcaption>{escape(picture.caption)}</figcaption>\n</figure>"


def _video(section: Section) -> str:
    label = f'aria-label="{escape(section.title)}" src="{section.video}"'
    if section.video.startswith("data:image"):
        return f'<img class="video" alt="{escape(section.title)}" src="{section.video}">'
    return f'<video class="video" controls loop muted playsinline {label}></video>'


def _told(story: Story, is_open: bool) -> str:
    head = "".join(f"<th>{name}</th>" for name in narrative.COLUMNS)
    width = len(narrative.COLUMNS)
    bodies = [
        f'<tbody><tr><th class="metric" colspan="{width}">{escape(heading)}</th></tr></tbody>'
        + "<tbody>"
        + "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
        + "</tbody>"
        for heading, rows in story.pegs
    ]
    table = f'<div class="table"><table><thead><tr>{head}</tr></thead>{"".join(bodies)}</table></div>'
    summary = f"<summary>{escape(story.title)}</summary><p>{escape(narrative.RULE)}</p>"
    return f"<details{' open' * is_open}>{summary}{table}</details>"


def _table(rows: Sequence[Row], paper: Mapping[tuple[str, str, str], float]) -> str:
    beside = {row: paper.get((row.method, row.metric, row.group)) for row in rows}
    has_paper = any(value is not None for value in beside.values())
    head = '<th>method</th><th>group</th><th>value [95 % interval]</th><th class="number">n</th>'
    head += '<th class="number">paper</th>' if has_paper else ""
    bodies = []
    by_metric = sorted(rows, key=lambda row: row.metric)
    for metric, of_metric in groupby(by_metric, key=lambda row: row.metric):
        bodies.append(
            f'<tbody><tr><th class="metric" colspan="{4 + has_paper}">{escape(metric)}</th></tr></tbody>'
        )
        for method, of_method in groupby(of_metric, key=lambda row: row.method):
            first, *rest = [_cells(row, beside[row], has_paper) for row in of_method]
            name = escape(method).replace("_", "_<wbr>")
            lines = [f'<th class="name" rowspan="{len(rest) + 1}">{name}</th>{first}', *rest]
            bodies.append("<tbody>" + "".join(f"<tr>{line}</tr>" for line in lines) + "</tbody>")
    table = f'<div class="table"><table><thead><tr>{head}</tr></thead>{"".join(bodies)}</table></div>'
    if len(rows) <= MOST_ROWS:
        return table
    return f"<details><summary>All {len(rows)} numbers</summary>{table}</details>"


def _cells(row: Row, paper: float | None, has_paper: bool) -> str:
    digits = 3 if row.metric.endswith("rate") else 2
    interval = "?" if row.low is None or row.high is None else f"{row.low:.{digits}f}, {row.high:.{digits}f}"
    beside = "" if paper is None else f"{paper:.{digits}f}"
    return (
        f"<td>{escape(row.group)}</td><td>{row.value:.{digits}f} <span>[{interval}]</span></td>"
        f'<td class="number">{row.n}</td>' + (f'<td class="number">{beside}</td>' if has_paper else "")
    )
