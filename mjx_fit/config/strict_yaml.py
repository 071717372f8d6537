"""Strict YAML: the core schema of YAML 1.2 without ambiguous or unneeded constructs.

``010`` is ten and ``1e-4`` a number; ``1:30``, ``yes`` and ``2026-01-01`` are text. Duplicate keys, anchors,
aliases, tags and multiple documents are rejected, as are things no configuration needs: long texts, deep
nesting, numbers of many digits, control characters. PyYAML scans and parses; its events are interpreted here,
since its own constructors follow YAML 1.1.
"""

import re
from collections.abc import Iterator
from typing import Any

import yaml

from mjx_fit.utils.errors import shortened, shown

MOST_BYTES = 128 * 1024
"""Largest text: thirty complete configurations, which PyYAML reads within half a second."""
MOST_VALUES = 10_000
MOST_LEVELS = 16
MOST_DIGITS = 100
"""Longest number, characters; 17 significant digits distinguish any two doubles."""

_NULL = {"", "~", "null", "Null", "NULL"}
_BOOL = dict.fromkeys(("true", "True", "TRUE"), True) | dict.fromkeys(("false", "False", "FALSE"), False)
_INT = re.compile(r"[-+]?[0-9]+")
_OCTAL, _HEXADECIMAL = re.compile(r"0o[0-7]+"), re.compile(r"0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_NO_TEXT = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x84\x86-\x9f\ud800-\udfff\ufeff\ufffe\uffff]")
"""Invalid characters: control characters, unpaired surrogates, byte order marks."""


class StrictYamlError(ValueError):
    """Invalid YAML; the one-line message names the problem and its position."""


def load(text: str) -> Any:
    """Parse a text to None, a bool, an int, a float, a str, or lists and dicts of them.

    Raises:
        StrictYamlError: The text is invalid.
    """
    _require_small(text)
    try:
        return _document(_counted(yaml.parse(text, Loader=yaml.SafeLoader)))
    except yaml.YAMLError as error:
        words = (getattr(error, "context", None), getattr(error, "problem", None) or str(error))
        mark = getattr(error, "problem_mark", None)
        text = " ".join(" ".join(part for part in words if part).split())
        raise StrictYamlError(_at(mark, f"invalid YAML: {shortened(text, 160)}")) from None
    except StrictYamlError:
        raise
    except (ValueError, OverflowError):  # raised by PyYAML for "\UFFFFFFFF"
        raise StrictYamlError("an escape \\U is out of range: expected U+0000 to U+10FFFF") from None


def _require_small(text: str) -> None:
    if len(text) > MOST_BYTES:
        raise StrictYamlError(f"{len(text)} characters are too many: expected at most {MOST_BYTES}")
    odd = _NO_TEXT.search(text)
    if odd is not None:
        line = text.count("\n", 0, odd.start()) + 1
        raise StrictYamlError(f"line {line}: the character U+{ord(odd[0]):04X} is invalid")


def _counted(events: Iterator[yaml.Event]) -> Iterator[yaml.Event]:
    for number, event in enumerate(events):
        if number > MOST_VALUES:
            raise _error(event, f"too many values: expected at most {MOST_VALUES}")
        yield event


def _document(events: Iterator[yaml.Event]) -> Any:
    """Build the value of the only document."""
    found: list[Any] = []
    for event in events:
        if isinstance(event, yaml.DocumentStartEvent):
            if found:
                raise _error(event, "a second document is not supported")
            if event.tags or event.version not in (None, (1, 2)):
                raise _error(event, "directives other than %YAML 1.2 are not supported")
        elif isinstance(event, yaml.NodeEvent):
            found.append(_value(event, events, 1))
    return found[0] if found else None


def _value(event: yaml.Event, events: Iterator[yaml.Event], level: int) -> Any:
    """Build the value that starts with an event, consuming its remaining events."""
    anchor, tag = getattr(event, "anchor", None), getattr(event, "tag", None)
    if anchor is not None:  # aliases have one, too
        raise _error(event, f"the anchor or alias {shown(anchor)} is not supported: write the value out")
    if tag is not None:
        raise _error(event, f"the tag {shown(tag)} is not supported: types follow from the values")
    if isinstance(event, yaml.ScalarEvent):
        return _scalar(event)
    if level > MOST_LEVELS:
        raise _error(event, f"nested too deeply: expected at most {MOST_LEVELS} levels")
    if isinstance(event, yaml.SequenceStartEvent):
        return [_value(item, events, level + 1) for item in _until(events, yaml.SequenceEndEvent)]
    return _mapping(events, level)


def _mapping(events: Iterator[yaml.Event], level: int) -> dict[str, Any]:
    mapping: dict[str, Any] = {}
    for event in _until(events, yaml.MappingEndEvent):
        if isinstance(event, yaml.ScalarEvent) and event.style is None and event.value == "<<":
            raise _error(event, "merge keys (<<) are not supported: write the values out")
        key = _value(event, events, level + 1)
        if not isinstance(key, str):
            raise _error(event, f"the key {shown(key)} is invalid: expected a name")
        if key in mapping:
            raise _error(event, f"the key {shown(key)} is given twice")
        mapping[key] = _value(next(events), events, level + 1)
    return mapping


def _until(events: Iterator[yaml.Event], end: type[yaml.Event]) -> Iterator[yaml.Event]:
    for event in events:
        if isinstance(event, end):
            return
        yield event


def _scalar(event: yaml.ScalarEvent) -> Any:
    """Convert a scalar by the core schema of YAML 1.2."""
    text: str = event.value
    odd = _NO_TEXT.search(text)  # from an escape such as "\0"
    if odd is not None:
        raise _error(event, f"the character U+{ord(odd[0]):04X} is invalid")
    if event.style is not None:
        return text
    if text in _NULL:
        return None
    if text in _BOOL:
        return _BOOL[text]
    if _NOT_FINITE.fullmatch(text):
        return float(text.replace(".", ""))
    for pattern, number in (
        (_INT, int),
        (_OCTAL, lambda digits: int(digits, 8)),
        (_HEXADECIMAL, lambda digits: int(digits, 16)),
        (_FLOAT, float),
    ):
        if pattern.fullmatch(text):
            if len(text) > MOST_DIGITS:
                raise _error(
                    event, f"{shown(text)} has too many digits ({len(text)}): expected at most {MOST_DIGITS}"
                )
            return number(text)
    return text


def _error(event: yaml.Event, what: str) -> StrictYamlError:
    return StrictYamlError(_at(event.start_mark, what))


def _at(mark: yaml.Mark | None, what: str) -> str:
    return what if mark is None else f"line {mark.line + 1}, column {mark.column + 1}: {what}"
