"""One-line messages for pydantic's validation errors: key, value, and allowed values."""

import dataclasses
import difflib
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from pydantic import Tag, ValidationError

from mjx_fit.utils.errors import shortened, shown

MOST_LISTED = 30
"""Maximum number of keys that a message lists in full."""


def in_words(error: ValidationError, schema: type) -> str:
    """Describe the first error: its key, its value, and the allowed values.

    Args:
        error: Error of validating ``schema``.
        schema: Dataclass whose fields are dataclasses, tuples, plain values or tagged unions.
    """
    first = _plainest(error.errors(include_url=False))
    place, kind, given = _without_tags(first["loc"], schema), first["type"], first["input"]
    field = _dotted(place)
    if kind == "unexpected_keyword_argument":
        known = _keys(members(_annotation(place[:-1], schema))[0])
        return f"{field}: unknown key; allowed here: {_listed(known, str(place[-1]))}"
    if kind == "value_error":  # raised by a section's own check, which names its key
        said = str(first.get("ctx", {}).get("error"))
        return f"{field}.{said}" if field else said
    if kind == "missing" and isinstance(given, list):  # one error per missing item
        missing = sum(one["type"] == "missing" for one in error.errors(include_url=False))
        return f"{_dotted(place[:-1])}: {len(given)} entries given: expected {len(given) + missing}"
    if kind == "missing":
        return f"{field}: it is missing"
    if kind in ("too_long", "too_short") and isinstance(given, list):
        word, key = ("most", "max_length") if kind == "too_long" else ("least", "min_length")
        return f"{field}: {len(given)} entries given: expected at {word} {first.get('ctx', {}).get(key)}"
    allowed = _allowed(_annotation(place, schema))
    return f"{field}: {shown(given)} is invalid: {f'expected {allowed}' if allowed else first['msg']}"


def _plainest(errors: list[Any]) -> Any:
    """Return the first error; for a missing key that may be mistyped, the one about the unknown key."""
    first = errors[0]
    return next(
        (
            one
            for one in errors
            if (first["type"], one["type"]) == ("missing", "unexpected_keyword_argument")
            and one["loc"][:-1] == first["loc"][:-1]
        ),
        first,
    )


def members(annotation: Any) -> tuple[Any, ...]:
    """Return the members of an annotated union except None, or the annotation itself if it is no union."""
    plain = get_args(annotation)[0] if get_origin(annotation) is Annotated else annotation
    if get_origin(plain) not in (Union, UnionType):
        return (annotation,)
    return tuple(one for one in get_args(plain) if one is not NoneType)


def plain_and_limits(annotation: Any) -> tuple[Any, dict[str, Any]]:
    """Split an annotation into the plain type and its metadata.

    Returns:
        Plain annotation, and those of ``ge``, ``le``, ``multiple_of``, ``min_length``, ``max_length`` and
        ``unit`` that the metadata state.
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
    units: dict[str, Any] = {}
    for field in rest:
        units |= getattr(field, "json_schema_extra", None) or {}
    return plain, limits | units


def _dotted(place: tuple[int | str, ...]) -> str:
    parts = (str(part) for part in place)
    return ".".join(shortened(part) if part.isprintable() else shown(part) for part in parts)


def _without_tags(place: tuple[int | str, ...], schema: type) -> tuple[int | str, ...]:
    """Remove the tags of union members, which are not part of the user's input, from a location."""
    return tuple(
        part
        for end, part in enumerate(place)
        if not any(_tag(one) == part for one in members(_annotation(place[:end], schema)))
    )


def _tag(annotation: Any) -> str | None:
    return next((one.tag for one in get_args(annotation)[1:] if isinstance(one, Tag)), None)


def _annotation(place: tuple[int | str, ...], schema: type) -> Any:
    """Return the annotation at a location, or None; a tag or an index selects the member of a union."""
    node: Any = schema
    for part in place:
        among = members(node)
        if any(_tag(one) == part for one in among):
            node = next(one for one in among if _tag(one) == part)
            continue
        node = next((one for one in among if get_origin(_plain(one)) is tuple), among[0])
        node = _plain(node)
        if dataclasses.is_dataclass(node):
            node = get_type_hints(node, include_extras=True).get(str(part))  # resolves names of later classes
        elif isinstance(part, int) and get_origin(node) is tuple:
            items = get_args(node)
            node = items[0] if items[-1] is Ellipsis else items[min(part, len(items) - 1)]
        else:
            return None
    return node


def _plain(annotation: Any) -> Any:
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    return annotation


def _listed(known: list[str], given: str) -> str:
    """List the known keys; of many, those most like the given one."""
    if len(known) <= MOST_LISTED:
        return ", ".join(known)
    similar = difflib.get_close_matches(given, known, cutoff=0.0)
    return f"{', '.join(similar)} and {len(known) - len(similar)} more; mjx-fit config lists them"


def _keys(node: Any) -> list[str]:
    return [field.name for field in dataclasses.fields(node)] if dataclasses.is_dataclass(node) else []


def _allowed(node: Any) -> str:
    """Describe the values that an annotation allows; empty if there is no short description."""
    among = members(node)
    if len(among) > 1:
        return " or ".join(_allowed(one) for one in among)
    node, limits = plain_and_limits(next(iter(among)))
    if node in (int, float) and {"ge", "le"} <= limits.keys():
        what = "a whole number" if node is int else "a number"
        times = f" and a multiple of {limits['multiple_of']}" if "multiple_of" in limits else ""
        return f"{what} from {limits['ge']} to {limits['le']}{times}"
    if node is bool:
        return "true or false"
    if get_origin(node) is Literal:
        return f"one of {', '.join(get_args(node))}"
    if dataclasses.is_dataclass(node):
        return ", ".join(_keys(node))
    return "a list" if get_origin(node) is tuple else ""
