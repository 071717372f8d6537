"""Sections of a report: facts, claims, rows and figures of one input."""

import base64
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import yaml
from pydantic import TypeAdapter

from mjx_fit.config.schema import config_from_stored
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.statistics import Row
from mjx_fit.report import claims, descriptions, narrative, paper_values
from mjx_fit.report.figures import catalogue
from mjx_fit.report.figures.catalogue import Drawing
from mjx_fit.report.figures.parts import parts as draw_parts
from mjx_fit.report.figures.style import Picture, picture
from mjx_fit.report.narrative import Story
from mjx_fit.utils import bounded_json
from mjx_fit.utils.errors import RequestError

VIDEOS = {".mp4": "video/mp4", ".gif": "image/gif"}
_BEGINS = {".mp4": (4, b"ftyp"), ".gif": (0, b"GIF8")}
"""Offset and content of the magic bytes of each format."""
_FACTS = TypeAdapter(dict[str, Any])
LARGEST_CONFIG = 2**20
"""Largest configuration file shown, in bytes."""
LARGEST_VIDEO = 20_000_000
"""Largest video embedded in a page, in bytes."""


@dataclass(frozen=True)
class Section:
    """One input, ready for the page.

    Attributes:
        slug: Short name, unique in a report, valid as a file name and an id.
        title: Heading.
        facts: Provenance and descriptions: (name, value).
        config: Resolved configuration as text; empty if unknown.
        rows: Summary of a result; empty for a data set or a run.
        pictures: Figures in order.
        stories: Single trials in words.
        video: Video to show, as ``data:`` address.
        paper: Values of the paper, by method, metric and group.
        versions: Library versions.
        about: Description of the experiment in a sentence or two.
        kind: Name of the experiment, ``data set``, ``training run`` or ``video``.
        claims: Claims that the rows support, in words.
        types: Names of the types that figures distinguish by colour.
        scene: Scene with the parts; None if unknown.
        epochs: Records of the epochs of a training run.
    """

    slug: str
    title: str
    facts: tuple[tuple[str, str], ...]
    config: str
    rows: tuple[Row, ...]
    pictures: tuple[Picture, ...] = ()
    stories: tuple[Story, ...] = ()
    video: str = ""
    paper: Mapping[tuple[str, str, str], float] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    about: str = ""
    kind: str = ""
    claims: tuple[str, ...] = ()
    types: tuple[str, ...] = ()
    scene: SceneConfig | None = None
    epochs: tuple[dict[str, Any], ...] = ()


def with_parts(made: list[Section]) -> list[Section]:
    """Add a picture of the parts to the first section of each set of parts."""
    seen: set[Any] = set()
    shown = []
    for section in made:
        scene = section.scene
        key = None if scene is None else (scene.shapes, scene.clearance_m)
        if scene is not None and key not in seen:
            seen.add(key)
            caption = "Pegs (blue) in their sockets, as seen from above, all at one scale."
            drawn = pictures_of(section.slug, [("parts", caption, partial(draw_parts, scene))])
            shown.append(replace(section, pictures=(*section.pictures, *drawn)))
        else:
            shown.append(section)
    return shown


def of_result(slug: str, result: Result) -> Section:
    """Return the section of a result file; an unknown experiment gets its table only."""
    known = descriptions.told(result.experiment, [row.method for row in result.summary])
    facts = (*known, *provenance(vars(result)))
    if differs := result.request.get("differs_from_training"):
        facts = (*facts, ("changed since training", "; ".join(map(str, differs))))
    config = yaml.safe_dump(result.config, sort_keys=False)
    title = f"Experiment: {result.experiment}" + (f" ({slug})" if slug != result.experiment else "")
    pictures = pictures_of(slug, catalogue.of_result(result))
    section = Section(slug, title, facts, config, tuple(result.summary), pictures)
    return replace(
        section,
        stories=narrative.of_result(result),
        paper=paper_values.beside(result.config),
        versions=result.versions,
        about=descriptions.about(result.experiment),
        kind=result.experiment,
        claims=claims.of_result(result),
        scene=_scene_of(result.config),
    )


def of_video(slug: str, path: Path) -> Section:
    """Return the section of a video, which is embedded in the page.

    Raises:
        RequestError: The file is too large to embed, or not a video.
    """
    size = path.stat().st_size
    if size > LARGEST_VIDEO:
        raise RequestError(
            f"report: {path} cannot be used: it has {size / 1e6:.0f} MB, the limit of a page is "
            f"{LARGEST_VIDEO / 1e6:.0f} MB; render it with a lower --fps or a higher --speed"
        )
    content, (at, begins) = path.read_bytes(), _BEGINS[path.suffix]
    if not content.startswith(begins, at):
        raise RequestError(f"report: {path} cannot be used: it is not a {path.suffix} video")
    address = f"data:{VIDEOS[path.suffix]};base64,{base64.b64encode(content).decode()}"
    return Section(slug, f"Video: {path.stem}", (), "", (), video=address, kind="video")


def pictures_of(slug: str, shown: list[Drawing]) -> tuple[Picture, ...]:
    """Draw the figures of a section."""
    return tuple(picture(f"{slug}-{name}", caption, draw) for name, caption, draw in shown)


def provenance(tree: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    """Return seed, engine, device and versions, as far as they are stored."""
    facts = []
    for name in ("seed", "engine", "device", "versions"):
        value = tree.get(name)
        if isinstance(value, dict):
            value = ", ".join(f"{library} {version}" for library, version in value.items())
        if value is not None:
            facts.append((name, str(value)))
    return tuple(facts)


def _scene_of(stored: dict[str, Any]) -> SceneConfig | None:
    """Return the scene of a stored configuration; None if today's library does not know it."""
    try:
        return config_from_stored(stored).scene
    except RequestError:
        return None


def text_of(path: Path) -> str:
    """Return a text file without unprintable characters; empty if it cannot be read."""
    try:
        text = bounded_json.read_text(path, LARGEST_CONFIG)
    except (OSError, ValueError):
        return ""
    return "".join(letter for letter in text if letter.isprintable() or letter == "\n")


def json_of(path: Path) -> dict[str, Any]:
    try:
        tree = bounded_json.check(_FACTS, bounded_json.read(path))
    except (OSError, ValueError):
        return {}  # optional: a run made elsewhere may lack this file
    return tree
