"""YAML as a researcher means it: the core schema of YAML 1.2, and nothing that could mean something else.

``010`` is ten, ``1e-4`` a number; ``1:30``, ``yes`` and ``2026-01-01`` are text. Keys that are given twice,
anchors, aliases, tags and several documents are refused, and so is what no configuration needs: much text,
deep nesting, numbers of many digits, control characters. PyYAML scans and parses; what its events mean is
said here, since its own constructors follow YAML 1.1.
"""

import re
from collections.abc import Iterator
from typing import Any

import yaml

from mjx_fit.utils.errors import shortened, shown

MOST_BYTES = 128 * 1024
"""Of text, thirty times a whole configuration: PyYAML reads so much within half a second."""
MOST_VALUES = 10_000
MOST_LEVELS = 16
MOST_DIGITS = 100
"""Characters of a number; 17 significant digits tell any double from the next."""

_NULL = {"", "~", "null", "Null", "NULL"}
_BOOL = dict.fromkeys(("true", "True", "TRUE"), True) | dict.fromkeys(("false", "False", "FALSE"), False)
_INT = re.compile(r"[-+]?[0-9]+")
_OCTAL, _HEXADECIMAL = re.compile(r"0o[0-7]+"), re.compile(r"0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_NO_TEXT = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x84\x86-\x9f\ud800-\udfff\ufeff\ufffe\uffff]")
"""Control characters, halves of surrogate pairs, byte order marks."""


class StrictYamlError(ValueError):
    """The text is invalid; one line says what and where."""


def load(text: str) -> Any:
    """What a text means: None, a bool, an int, a float, a str, or lists and dicts of them.

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
        raise StrictYamlError(_at(mark, f"it is no YAML: {shortened(text, 160)}")) from None
    except StrictYamlError:
        raise
    except (ValueError, OverflowError):  # PyYAML's own, of "\UFFFFFFFF"
        raise StrictYamlError("an escape \\U names no character: there are U+0000 to U+10FFFF") from None


def _require_small(text: str) -> None:
    if len(text) > MOST_BYTES:
        raise StrictYamlError(f"it has {len(text)} characters: at most {MOST_BYTES} are allowed")
    odd = _NO_TEXT.search(text)
    if odd is not None:
        line = text.count("\n", 0, odd.start()) + 1
        raise StrictYamlError(f"line {line}: the character U+{ord(odd[0]):04X} is invalid")


def _counted(events: Iterator[yaml.Event]) -> Iterator[yaml.Event]:
    for number, event in enumerate(events):
        if number > MOST_VALUES:
            raise _error(event, f"it has more than {MOST_VALUES} values")
        yield event


def _document(events: Iterator[yaml.Event]) -> Any:
    """The value of the only document."""
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
    """The value that begins with an event; takes its other events."""
    anchor, tag = getattr(event, "anchor", None), getattr(event, "tag", None)
    if anchor is not None:  # an alias has one, too
        raise _error(event, f"the anchor or alias {shown(anchor)} is not supported: write the value out")
    if tag is not None:
        raise _error(event, f"the tag {shown(tag)} is not supported: values mean what they look like")
    if isinstance(event, yaml.ScalarEvent):
        return _scalar(event)
    if level > MOST_LEVELS:
        raise _error(event, f"it nests more than {MOST_LEVELS} levels")
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
            raise _error(event, f"the key {shown(key)} cannot be used: a key is a name")
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
    """What a scalar means by the core schema of YAML 1.2."""
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
                    event, f"{shown(text)} has {len(text)} digits: at most {MOST_DIGITS} are allowed"
                )
            return number(text)
    return text


def _error(event: yaml.Event, what: str) -> StrictYamlError:
    return StrictYamlError(_at(event.start_mark, what))


def _at(mark: yaml.Mark | None, what: str) -> str:
    return what if mark is None else f"line {mark.line + 1}, column {mark.column + 1}: {what}"
