"""Untrusted JSON: bounded in size and depth, without Python's extensions.

Every external JSON file is read with ``read`` or ``loads``, then validated against a schema with ``check``.
All three raise ``ValueError`` with a one-line message that is safe to print.
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
"""Largest nesting depth: our files have seven levels, and recursive functions can handle this many."""
MAX_INTEGER = 2**63 - 1
MAX_BYTES = 2**20
"""Default size limit, for small files such as ``run.json``."""

_BLOCK = 1 << 24
_QUOTE = 2
_MARKS = np.zeros(256, np.int8)
_MARKS[list(b"[{")], _MARKS[list(b"]}")], _MARKS[ord('"')] = 1, -1, _QUOTE
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")
_SHOWN = 80


def read(path: Path, largest: int = MAX_BYTES) -> Any:
    """Read a JSON file.

    Args:
        path: JSON file.
        largest: Size limit, bytes.

    Raises:
        OSError: The file cannot be read.
        ValueError: The file is too large, or not JSON within the bounds.
    """
    return loads(read_text(path, largest), largest)


def read_text(path: Path, largest: int = MAX_BYTES) -> str:
    """Read a text file of bounded size; other entries, such as pipes, are not opened.

    Raises:
        OSError: The file cannot be read.
        ValueError: The file is too large, not a regular file, or not UTF-8.
    """
    told = path.stat()
    if not stat.S_ISREG(told.st_mode):
        raise ValueError("it is not a regular file")
    if told.st_size <= largest:
        with path.open("rb") as file:
            content = file.read(largest + 1)  # it may have grown
        if len(content) <= largest:
            return content.decode("utf-8")
    raise ValueError(f"it has more than {largest:,} bytes")


def loads(text: str, largest: int = MAX_BYTES, *, nan_is_null: bool = False) -> Any:
    """Parse a JSON text.

    Args:
        text: JSON text.
        largest: Size limit, bytes.
        nan_is_null: Read NaN and infinities, which Python writes for losses, as null.

    Raises:
        ValueError: The text is too large or nested too deeply, is not JSON, or contains NaN, an infinite
            number, an integer of more than 63 bits, a duplicate key or an unpaired surrogate.
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
    """Validate a tree against a schema, and return it.

    Raises:
        ValueError: The tree is invalid; the message names the first invalid entry.
    """
    try:
        return schema.validate_python(tree)
    except ValidationError as error:
        raise ValueError(what_is_wrong(error)) from None


def what_is_wrong(error: ValidationError) -> str:
    """Describe the first error of a validation, in one line of bounded length."""
    first = error.errors(include_url=False)[0]
    where = ".".join(_shown(part) for part in first["loc"])
    if first["type"] == "missing":
        return f"the key {where} is missing"
    if first["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        return f"the key {where} is unknown"
    what = " ".join(first["msg"].split())[: 2 * _SHOWN]
    if first["type"] == "value_error":  # raised by one of our own checks, whose message is complete
        return f"{where}: {what}".removeprefix(": ")
    return f"{where}: {_shown(first['input'], quoted=True)} cannot be used: {what}"


def _shown(value: Any, *, quoted: bool = False) -> str:
    """Format a part of a file for a message: short, and without control characters."""
    if isinstance(value, str) and not quoted and value.isprintable():
        words = value
    elif isinstance(value, str | int | float | bool | None):
        words = ascii(value)
    else:
        words = f"a {type(value).__name__} of {len(value)}" if hasattr(value, "__len__") else "this"
    return words if len(words) <= _SHOWN else words[: _SHOWN - 1] + "…"


def _depth(content: bytes) -> int:
    """Compute the nesting depth of brackets outside strings, without recursion."""
    if b"\\" in content:
        content = re.sub(rb"\\.", b"__", content, flags=re.DOTALL)  # an escaped quote does not end a string
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
        raise ValueError(f"the key {_shown(twice, quoted=True)} appears twice")
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
    raise ValueError(f"{text} is not a JSON number")


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
        raise ValueError(f"the text {_shown(tree, quoted=True)} contains an unpaired surrogate")
