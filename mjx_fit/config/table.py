"""Table of all configuration keys with unit, allowed values, default and description.

Everything is read from the schema in ``mjx_fit.config.sections``: annotations, defaults and docstrings.
"""

import dataclasses
import inspect
import re
from typing import Any, Literal, get_args, get_origin

from mjx_fit.config.quantities import MEASURED, QUANTITIES
from mjx_fit.config.schema import Config, config_to_tree, in_words
from mjx_fit.config.schema_errors import members, plain_and_limits

WIDTH, LEAST = 110, 22
"""Width of a line, and the room that a description gets even in a wider line, characters."""
SUFFIXES = {"m": "m", "s": "s", "n": "N", "nm": "N·m", "rad": "rad"}
"""Units by the suffixes of names such as ``clearance_m``; other keys state theirs in the schema."""
PURE = "1"
"""Unit of dimensionless numbers."""


@dataclasses.dataclass(frozen=True)
class Key:
    """One configuration key.

    Attributes:
        section: Section of the key.
        name: Name within the section.
        unit: Unit of the values; ``1`` for dimensionless numbers, ``-`` for words.
        allowed: Range or choices, as text.
        default: Default value, JSON-ready.
        value: Value in the given configuration, JSON-ready.
        description: Description in a few sentences.
    """

    section: str
    name: str
    unit: str
    allowed: str
    default: Any
    value: Any
    description: str


def keys(config: Config) -> list[Key]:
    """List all keys in the order of the schema, with their values in a configuration."""
    default, value = config_to_tree(Config()), config_to_tree(config)
    return [
        Key(
            section,
            field.name,
            _unit_of(section, field.name),
            _allowed(field.type),
            default[section][field.name],
            value[section][field.name],
            _descriptions(type(schema))[field.name],
        )
        for section, schema in vars(Config()).items()
        for field in dataclasses.fields(schema)
    ]


def as_text(table: list[Key]) -> str:
    """Format one line per key, grouped by section; an extra column shows values other than the default."""
    differ = any(key.value != key.default for key in table)
    head = ("key", "unit", "allowed", "default", *(["value"] * differ), "description")
    rows = [_row(key, differ) for key in table]
    widths = [max(len(row[column]) for row in [head, *rows]) for column in range(len(head) - 1)]
    lines, section = [_line(head, widths)], ""
    for key, row in zip(table, rows, strict=True):
        if key.section != section:
            section = key.section
            lines += ["", f"{section}: {_summary(type(getattr(Config(), section)))}"]
        lines.append(_line(row, widths))
    return "\n".join(lines)


def as_json(table: list[Key]) -> list[dict[str, Any]]:
    """Convert each key to a JSON-ready object."""
    return [dataclasses.asdict(key) for key in table]


def _row(key: Key, differ: bool) -> tuple[str, ...]:
    here = [_short(key.value) if key.value != key.default else ""] * differ
    sentence = key.description.partition(". ")[0].removesuffix(".")
    return (f"  {key.name}", key.unit, key.allowed, _short(key.default), *here, sentence)


def _line(row: tuple[str, ...], widths: list[int]) -> str:
    start = "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=False))
    room = max(WIDTH - len(start) - 2, LEAST)
    text = row[-1]
    if len(text) > room:
        text = text[: max(0, room - 1)].rpartition(" ")[0].rstrip(",(") + "…"
    return f"{start}  {text}"


def _short(value: Any) -> str:
    """Format a value briefly, nothing as YAML's null."""
    if value is None:
        return "null"
    if not isinstance(value, list):
        return str(value).lower() if isinstance(value, bool) else in_words(value)
    items = [_short(one.get("name") if isinstance(one, dict) else one) for one in value]
    text = ", ".join(items)
    if any(isinstance(one, list) for one in value):
        return f"{len(value)} lists"
    return text if len(text) <= 16 else f"{items[0]} ... {items[-1]}"


def _unit_of(section: str, name: str) -> str:
    """Return the unit of a key; a distribution has that of the quantity."""
    if section == "randomize" and name in QUANTITIES:
        return QUANTITIES[name].unit
    holder = getattr(Config(), MEASURED.get(name, section) if section == "randomize" else section)
    return _unit(name, {field.name: field.type for field in dataclasses.fields(holder)}[name])


def _unit(name: str, annotation: Any) -> str:
    plain, limits = plain_and_limits(members(annotation)[0])
    if "unit" in limits:
        return limits["unit"]
    suffix = name.rpartition("_")[2]
    if "_" in name and suffix in SUFFIXES:
        return SUFFIXES[suffix]
    if get_origin(plain) is tuple:
        return _unit("", get_args(plain)[0])
    return PURE if plain in (int, float) else "-"


def _allowed(annotation: Any) -> str:
    """Describe the allowed values: a range, choices, or the number and type of entries."""
    plain, limits = plain_and_limits(members(annotation)[0])  # the usual member of a union, for brevity
    if plain is bool:
        return "true, false"
    if get_origin(plain) is Literal:
        return ", ".join(get_args(plain))
    if get_origin(plain) is tuple:
        items = get_args(plain)
        if items[-1] is not Ellipsis:
            return f"{len(items)} x {_allowed(items[0])}"
        counts = [str(limits[end]) for end in ("min_length", "max_length") if end in limits]
        of = "names" if get_origin(items[0]) is Literal else f"x {_allowed(items[0])}"
        return f"{'-'.join(counts) or 'n'} {of}"
    if dataclasses.is_dataclass(plain):
        return getattr(plain, "__name__", str(plain)).lower()
    times = f", by {limits['multiple_of']}" if "multiple_of" in limits else ""
    return f"{limits['ge']} to {limits['le']}{times}"


def _summary(schema: type) -> str:
    return (inspect.getdoc(schema) or "").partition("\n")[0]


def _descriptions(schema: type) -> dict[str, str]:
    """Parse the attribute descriptions of a docstring, by name."""
    text = (inspect.getdoc(schema) or "").partition("Attributes:\n")[2]
    found = re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", text, re.MULTILINE)
    return {name: re.sub(r"\s+", " ", words).replace("``", "") for name, words in found}
