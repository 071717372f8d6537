"""JSON that others may have written: bounded in size and depth, and without what Python alone reads in it.

Every JSON file that comes from elsewhere goes through here: ``read`` or ``loads``, then ``check`` with a
schema. All three raise ``ValueError`` with one line that can be printed.
"""

import json
import math
import re
import stat
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

MAX_DEPTH = 64
"""Levels of nesting: ours have seven; what walks a tree by recursion has room for this many."""
MAX_INTEGER = 2**63 - 1
MAX_BYTES = 2**20
"""Size of a file about one thing, such as ``run.json``, unless its reader says otherwise."""

_BLOCK = 1 << 24
_QUOTE = 2
_MARKS = np.zeros(256, np.int8)
_MARKS[list(b"[{")], _MARKS[list(b"]}")], _MARKS[ord('"')] = 1, -1, _QUOTE
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")
_SHOWN = 80


def read(path: Path, largest: int = MAX_BYTES) -> Any:
    """What a JSON file holds.

    Args:
        path: The file.
        largest: Bytes that it may have.

    Raises:
        OSError: It cannot be read.
        ValueError: It is larger, or not JSON within the bounds.
    """
    return loads(read_text(path, largest), largest)


def read_text(path: Path, largest: int = MAX_BYTES) -> str:
    """The text of a file that may not have more bytes; what is no file, such as a pipe, is not opened.

    Raises:
        OSError: It cannot be read.
        ValueError: It is larger, no regular file, or not UTF-8.
    """
    told = path.stat()
    if not stat.S_ISREG(told.st_mode):
        raise ValueError("it is no regular file")
    if told.st_size <= largest:
        with path.open("rb") as file:
            content = file.read(largest + 1)  # it may have grown
        if len(content) <= largest:
            return content.decode("utf-8")
    raise ValueError(f"it has more than {largest:,} bytes")


def loads(text: str, largest: int = MAX_BYTES, *, nan_is_null: bool = False) -> Any:
    """What a JSON text holds.

    Args:
        text: The text.
        largest: Bytes that it may have.
        nan_is_null: Whether NaN and the infinities, which Python writes of losses, are read as null.

    Raises:
        ValueError: It is larger or nested too deeply, it is not JSON, or holds NaN, an infinite number, an
            integer of more than 63 bits, a key twice or half a surrogate pair.
    """
    content = text.encode()
    if len(content) > largest:
        raise ValueError(f"it has more than {largest:,} bytes")
    if _depth(content) > MAX_DEPTH:
        raise ValueError(f"it is nested more than {MAX_DEPTH} levels deep")
    tree = json.loads(
        text,
        object_pairs_hook=_object,
        parse_float=_float,
        parse_int=_int,
        parse_constant=_null if nan_is_null else _constant,
    )
    if _SURROGATE.search(text):
        _require_text(tree)
    return tree


def check(schema: TypeAdapter, tree: Any) -> Any:
    """The tree, where it is as a schema says.

    Raises:
        ValueError: It is not; the message names the first place where.
    """
    try:
        return schema.validate_python(tree)
    except ValidationError as error:
        raise ValueError(what_is_wrong(error)) from None


def what_is_wrong(error: ValidationError) -> str:
    """The first thing that a schema found, in one line of bounded length."""
    first = error.errors(include_url=False)[0]
    where = ".".join(_shown(part) for part in first["loc"])
    if first["type"] == "missing":
        return f"the key {where} is missing"
    if first["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        return f"the key {where} is unknown"
    what = " ".join(first["msg"].split())[: 2 * _SHOWN]
    if first["type"] == "value_error":  # one of our own checks, which says all
        return f"{where}: {what}".removeprefix(": ")
    return f"{where}: {_shown(first['input'], quoted=True)} cannot be used: {what}"


def _shown(value: Any, *, quoted: bool = False) -> str:
    """A part of a file as it may stand in a message: short, and nothing in it that a terminal acts on."""
    if isinstance(value, str) and not quoted and value.isprintable():
        words = value
    elif isinstance(value, str | int | float | bool | None):
        words = ascii(value)
    else:
        words = f"a {type(value).__name__} of {len(value)}" if hasattr(value, "__len__") else "this"
    return words if len(words) <= _SHOWN else words[: _SHOWN - 1] + "…"


def _depth(content: bytes) -> int:
    """Most brackets that are open at once, strings left out; found before anything recurses."""
    if b"\\" in content:
        content = re.sub(rb"\\.", b"__", content, flags=re.DOTALL)  # no quote in it ends a string
    deepest = depth = inside = 0
    for start in range(0, len(content), _BLOCK):
        block = np.frombuffer(content, np.uint8, min(_BLOCK, len(content) - start), start)
        marks = _MARKS[block]
        marks = marks[marks != 0]
        quotes = np.cumsum(marks == _QUOTE) + inside
        depths = depth + np.cumsum(np.where((quotes % 2 == 1) | (marks == _QUOTE), 0, marks))
        if len(marks):
            deepest, depth, inside = max(deepest, int(depths.max())), int(depths[-1]), int(quotes[-1])
    return deepest


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    tree = dict(pairs)
    if len(tree) < len(pairs):
        seen: set[str] = set()
        twice = next(key for key, _ in pairs if key in seen or seen.add(key))
        raise ValueError(f"the key {_shown(twice, quoted=True)} stands there twice")
    return tree


def _float(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"the number {_shown(text)} is too large")
    return value


def _int(text: str) -> int:
    if len(text) <= 20 and abs(value := int(text)) <= MAX_INTEGER:
        return value
    raise ValueError(f"the number {_shown(text)} is too large")


def _constant(text: str) -> float:
    raise ValueError(f"{text} is no number of JSON")


def _null(_: str) -> None:
    return None


def _require_text(tree: Any) -> None:
    if isinstance(tree, dict):
        for key, value in tree.items():
            _require_text(key)
            _require_text(value)
    elif isinstance(tree, list):
        for value in tree:
            _require_text(value)
    elif isinstance(tree, str) and any("\ud800" <= letter <= "\udfff" for letter in tree):
        raise ValueError(f"the text {_shown(tree, quoted=True)} holds half a surrogate pair")
