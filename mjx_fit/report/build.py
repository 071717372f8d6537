"""Build a report from paths: find the inputs, draw every figure, then write the page."""

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

from mjx_fit.evaluation import results
from mjx_fit.report import run_section, sections
from mjx_fit.report.data_section import of_dataset
from mjx_fit.report.page import GENERATOR, page
from mjx_fit.report.sections import Section
from mjx_fit.utils import files, locks
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.filesystem import path_inside

UNFINISHED = (
    f"<!doctype html>\n<html lang=en>\n{GENERATOR}\n<title>Not finished</title>\n"
    "<p>This report is unfinished: rerun its command.</p>\n"
)
"""Placeholder page while the figures are being written."""
LOOKED_AT = 2**24
"""Number of leading bytes of a JSON file searched for ``"experiment"``; result files have it on line two."""

_Maker = Callable[[str], Section]


def build(inputs: list[Path], out: Path) -> Path:
    """Write ``index.html`` and ``figures/*.svg``; calling it again completes an interrupted report.

    Args:
        inputs: Result files, videos, folders of a training run (``metrics.jsonl``) or a data set
            (``manifest.json``), and folders that contain these directly or one level down.
        out: Report folder.

    Returns:
        Path of the page.

    Raises:
        RequestError: An input does not exist, is damaged or contains nothing to show, or the folder contains
            files other than a report or the inputs. Nothing is written.
    """
    if out.exists() and not out.is_dir():
        raise RequestError(f"report: --out {out} is a file; it must be a folder")
    _require_ours(inputs, out)
    found: dict[Path, tuple[str, _Maker]] = {}
    for path in inputs:
        if not path.exists():
            raise RequestError(f"report: {path} does not exist")
        here = _find(path)
        if not here:
            raise RequestError(f"report: {path} contains no result file, training run or data set")
        found |= here
    slugs = _unique([name for name, _ in found.values()])
    made = [make(slug) for slug, (_, make) in zip(slugs, found.values(), strict=True)]
    made.sort(key=lambda section: not section.video)  # videos first
    made = run_section.with_comparison(sections.with_parts(made))
    with locks.holding(out):
        _require_ours(inputs, out)  # another process may have written there
        _write(made, out)
    return out / "index.html"


def _write(made: list[Section], out: Path) -> None:
    index, figures = out / "index.html", path_inside(out, "figures")
    if not index.exists():  # marks an interrupted report as ours
        files.write_text(index, UNFINISHED)
    for section in made:
        for picture in section.pictures:
            files.write_text(figures / f"{picture.name}.svg", picture.svg)
    files.write_text(index, page(made))


def beside(path: Path) -> Path:
    """Return the default report folder: ``report`` inside a folder, or next to a file."""
    return (path if path.is_dir() else path.parent) / "report"


def _require_ours(inputs: list[Path], out: Path) -> None:
    """Refuse any folder but a new one, a report of ours, or an input folder."""
    index = out / "index.html"
    if index.exists() and GENERATOR not in index.read_text(encoding="utf-8", errors="replace"):
        raise RequestError(f"report: --out {out} cannot be used: its index.html is not a report")
    beside = out.resolve() in [path.resolve() for path in inputs]
    foreign = files.foreign(out, {index.name})
    if foreign and not index.exists() and not beside:
        raise RequestError(f"report: --out {out} cannot be used: it holds other files ({foreign[0]})")


def _find(path: Path, depth: int = 1) -> dict[Path, tuple[str, _Maker]]:
    """Return what can be shown at a path: the name and section maker of each source."""
    if path.suffix in sections.VIDEOS and path.is_file():
        return {path.resolve(): (path.stem, partial(sections.of_video, path=path))}
    if path.is_file():
        return {path.resolve(): (path.stem, partial(_of_result, path=path))}
    found: dict[Path, tuple[str, _Maker]] = {}
    name = path.resolve().name
    if (path / "manifest.json").is_file():
        found[path.resolve() / "manifest.json"] = (name, partial(of_dataset, folder=path))
    if (path / "metrics.jsonl").is_file():
        found[path.resolve() / "metrics.jsonl"] = (name, partial(run_section.of_run, folder=path))
    for entry in sorted(path.iterdir()):
        result = entry.suffix == ".json" and entry.is_file() and _is_result(entry)
        if result or entry.suffix in sections.VIDEOS:
            found |= _find(entry)
        elif entry.is_dir() and depth:
            found |= _find(entry, depth - 1)
    return found


def _of_result(slug: str, path: Path) -> Section:
    result = results.read(path)
    if not result.summary:
        raise RequestError(f"report: {path} has an empty summary: nothing to show")
    return sections.of_result(slug, result)


def _is_result(path: Path) -> bool:
    """Return whether a JSON file claims to be a result: a damaged one must be reported, not skipped."""
    with path.open("rb") as file:  # may be larger than any result file
        return b'"experiment"' in file.read(LOOKED_AT)


def _unique(names: list[str]) -> list[str]:
    """Return the names as slugs, with a number appended to repeated ones."""
    slugs: list[str] = []
    for name in names:
        base = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-") or "input"
        slug, number = base, 2
        while slug in slugs:
            slug, number = f"{base}-{number}", number + 1
        slugs.append(slug)
    return slugs
