"""What pydantic found wrong with a configuration, in one line: where, which value, and what is allowed."""

import dataclasses
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import ValidationError

from mjx_fit.errors import shortened, shown


def in_words(error: ValidationError, schema: type) -> str:
    """What is wrong first, where, and what is allowed there.

    Args:
        error: Of validating ``schema``.
        schema: A dataclass, of dataclasses, tuples and plain values.
    """
    first = error.errors(include_url=False)[0]
    place, kind, given = first["loc"], first["type"], first["input"]
    field = _dotted(place)
    if kind == "unexpected_keyword_argument":
        return f"{field}: unknown key; allowed here: {', '.join(_keys(_annotation(place[:-1], schema)))}"
    if kind == "value_error":  # of a section's own check, which names its key
        said = str(first.get("ctx", {}).get("error"))
        return f"{field}.{said}" if field else said
    if kind == "missing" and isinstance(given, list):  # one error for each that is
        missing = sum(one["type"] == "missing" for one in error.errors(include_url=False))
        return f"{_dotted(place[:-1])}: {len(given)} given, {len(given) + missing} are needed"
    if kind == "missing":
        return f"{field}: it is missing"
    if kind in ("too_long", "too_short") and isinstance(given, list):
        word, key = ("most", "max_length") if kind == "too_long" else ("least", "min_length")
        return f"{field}: {len(given)} given, at {word} {first.get('ctx', {}).get(key)} are allowed"
    return f"{field}: {shown(given)} is not allowed: {_allowed(_annotation(place, schema)) or first['msg']}"


def plain_and_limits(annotation: Any) -> tuple[Any, dict[str, Any]]:
    """An annotation without its metadata, and what those say.

    Returns:
        The plain annotation; of ``ge``, ``le``, ``multiple_of``, ``min_length``, ``max_length`` and ``unit``
        those that are stated.
    """
    if get_origin(annotation) is not Annotated:
        return annotation, {}
    plain, *rest = get_args(annotation)
    limits = {
        name: getattr(one, name)
        for field in rest
        for one in getattr(field, "metadata", ())
        for name in ("ge", "le", "multiple_of", "min_length", "max_length")
        if hasattr(one, name)
    }
    units = {name: unit for field in rest for name, unit in (field.json_schema_extra or {}).items()}
    return plain, limits | units


def _dotted(place: tuple[int | str, ...]) -> str:
    parts = (str(part) for part in place)
    return ".".join(shortened(part) if part.isprintable() else shown(part) for part in parts)


def _annotation(place: tuple[int | str, ...], schema: type) -> Any:
    """How the field at a place is annotated, or None."""
    node: Any = schema
    for part in place:
        node = get_args(node)[0] if get_origin(node) is Annotated else node
        if dataclasses.is_dataclass(node):
            node = {field.name: field.type for field in dataclasses.fields(node)}.get(str(part))
        elif isinstance(part, int) and get_origin(node) is tuple:
            items = get_args(node)
            node = items[0] if items[-1] is Ellipsis else items[min(part, len(items) - 1)]
        else:
            return None
    return node


def _keys(node: Any) -> list[str]:
    return [field.name for field in dataclasses.fields(node)] if dataclasses.is_dataclass(node) else []


def _allowed(node: Any) -> str:
    """What a field that is annotated so may be, or nothing."""
    node, limits = plain_and_limits(node)
    if node in (int, float) and {"ge", "le"} <= limits.keys():
        what = "a whole number" if node is int else "a number"
        times = f" and a multiple of {limits['multiple_of']}" if "multiple_of" in limits else ""
        return f"it must be {what} between {limits['ge']} and {limits['le']}{times}"
    if node is bool:
        return "it must be true or false"
    if get_origin(node) is Literal:
        return f"it must be one of {', '.join(get_args(node))}"
    if dataclasses.is_dataclass(node):
        return f"it must hold {', '.join(_keys(node))}"
    return "it must be a list" if get_origin(node) is tuple else ""
