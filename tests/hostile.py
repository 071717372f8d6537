"""Random configurations for tests: sane ones at random places of their ranges, and hostile ones."""

import dataclasses
import math
import random
from collections.abc import Iterator
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from mjx_fit.config.randomized import allowed_range
from mjx_fit.config.schema import Config
from mjx_fit.config.sections.randomize import Distribution

SEED = 20261126
Request = tuple[list[bytes], list[str]]
"""The contents of configuration files, and --set strings."""


def numbers() -> Iterator[tuple[str, str, type, float, float]]:
    """Section, key, kind and both ends of every key that is one number."""
    for section, key, kind in _fields():
        if get_origin(kind) is Annotated:
            plain, *rest = get_args(kind)
            ends = {
                name: getattr(one, name)
                for field in rest
                for one in field.metadata
                for name in ("ge", "le")
                if hasattr(one, name)
            }
            if plain in (int, float):
                yield section, key, plain, ends.get("ge", -math.inf), ends.get("le", math.inf)


def requests(count: int) -> Iterator[Request]:
    """Requests, the same every time: about a third sane."""
    rng = random.Random(SEED)
    for _ in range(count):
        kind = rng.random()
        if kind < 0.4:
            yield _split(rng, [_sane(rng) for _ in range(rng.choice((1, 2, 3, 4, 6, 9)))])
        elif kind < 0.85:
            pairs = [_sane(rng) for _ in range(rng.randrange(3))] + [_hostile(rng)]
            rng.shuffle(pairs)
            yield _split(rng, pairs)
        elif kind < 0.95:
            yield [rng.choice(FILES)], []
        else:
            yield [rng.randbytes(rng.randrange(200))], ["".join(rng.choices(ALPHABET, k=rng.randrange(30)))]


def write(request: Request, folder: Path) -> tuple[list[Path], list[str]]:
    """A request with its files written."""
    contents, sets = request
    paths = [folder / f"{i}.yaml" for i in range(len(contents))]
    for path, content in zip(paths, contents, strict=True):
        path.write_bytes(content)
    return paths, sets


def _fields() -> Iterator[tuple[str, str, Any]]:
    for section, schema in vars(Config()).items():
        for field in dataclasses.fields(schema):
            members = get_args(field.type) if get_origin(field.type) in (Union, UnionType) else (field.type,)
            yield section, field.name, members[0]  # the other is null


def _sane(rng: random.Random) -> tuple[str, str, str]:
    """A key and a value that is allowed there, alone."""
    section, key, kind = rng.choice([field for field in _fields() if field[1] not in _LISTS])
    if kind is bool:
        return section, key, rng.choice(("true", "false"))
    if kind is Distribution:
        low, high = allowed_range(key)
        ends = sorted(float(f"{_between(rng, low, high):.4g}") for _ in range(2))
        return section, key, f"{{uniform: [{ends[0]!r}, {ends[1]!r}]}}"
    if get_origin(kind) is Literal:
        return section, key, rng.choice(get_args(kind))
    plain, low, high = next(one[2:] for one in numbers() if one[:2] == (section, key))
    if key in ("radius_m", "reach_m"):
        high = 0.03  # so that about as many fit their plate as do not
    value = rng.choice((low, high)) if rng.random() < 0.15 else _between(rng, low, high)
    if key == "width":
        value = 4 * (value // 4)
    return section, key, str(round(value)) if plain is int else repr(float(f"{value:.4g}"))


def _between(rng: random.Random, low: float, high: float) -> float:
    if low > 0 and rng.random() < 0.7:
        return min(max(math.exp(rng.uniform(math.log(low), math.log(high))), low), high)
    return rng.uniform(low, high)


def _hostile(rng: random.Random) -> tuple[str, str, str]:
    section, key, _ = rng.choice(list(_fields()))
    if rng.random() < 0.1:
        section = rng.choice(("", "scen", "scene ", "1", "~", "<<", "a" * 1000, "\u202e", "section\x00"))
    if rng.random() < 0.1:
        key = rng.choice(
            ("", "x", "name.x", "true", "<<", "b" * 100_000, "\ud800", "2026-01-01", "friction ")
        )
    return section, key, rng.choice(VALUES)


def _split(rng: random.Random, pairs: list[tuple[str, str, str]]) -> Request:
    """The pairs as --set strings, or some of them in one or two files."""
    files: list[dict[str, list[str]]] = [{} for _ in range(rng.randrange(3))]
    sets = []
    for section, key, value in pairs:
        if files and rng.random() < 0.6:
            rng.choice(files).setdefault(section, []).append(f"  {key}: {value}")
        else:
            sets.append(f"{section}.{key}={value}")
    texts = [
        "\n".join(f"{section}:\n" + "\n".join(lines) for section, lines in file.items()) for file in files
    ]
    return [text.encode("utf-8", "surrogatepass") for text in texts], sets


_LISTS = {
    "coordinates",
    "shapes",
    "success_probability",
    "error_knots_m",
    "success_by_error",
    "conv_channels",
}
ALPHABET = "sceneabtrk.._==:{}[]&*!|>'\"0123456789-+ \t\n\x00é٣\ud800"
_SHAPES = "[{{name: a, rectangles: [{}]}}, {{name: b, rectangles: [{}]}}, {{name: c, rectangles: [{}]}}]"
_GOOD = "[-0.01, -0.01, 0.01, 0.01]"

VALUES = (
    *("1e308", "-1e308", "1e-308", "1e400", "-0.0", "1e300", "1e9", "-1", "0", "9999999999", "5e-324"),
    *(".inf", "-.inf", ".nan", "nan", "inf", "Infinity", "1e", "0x", "1_000", "010", "0o17", "0x1F", "0b1"),
    *("9" * 5000, "1" + "0" * 400, "-" + "9" * 60, "0." + "3" * 5000, "1e" + "9" * 90),
    *("1:30", "2026-02-30", "2020-01-01", "2020-01-01T00:00:00Z", "yes", "no", "on", "true", "~", "", "''"),
    *("'1'", '"0.3"', "٣", "½", "\x00", "\x07", "\x1b[2J", "\ud800", "\ufeff1", "\u202e1", "\u2028"),
    *('"\\0"', '"\\uD800"', '"\\UFFFFFFFF"', '"\\x41"', "@x", "`x`", "%x", "|", ">-", "- 1", "? 1", ": 1"),
    *("!!int x", "!!int 3", "!!float x", "!!bool maybe", "!!binary x", "!!timestamp 2026-02-30", "!x 1"),
    *("!!python/object/apply:os.system [id]", "!!python/name:os.system", "!!set {a}", "!!omap [a: 1]"),
    *("&a 1", "*a", "&s {self: *s}", "&a [*a, *a]", "{<<: {a: 1}}", "{a: 1, a: 2}", "{a: {b: 1, b: 1}}"),
    *("[]", "{}", "[1, 2]", "[[1]]", "{a: 1}", "[1, [2, [3]]]", "[null, null, null]", "[.nan, .nan, .nan]"),
    *("[" * 100_000, "[" * 1000 + "]" * 1000, "{a: " * 1000, "{a: " * 15 + "1" + "}" * 15, "- " * 1000),
    *("[" + "1, " * 3000 + "1]", "[" + "1, " * 40_000 + "1]", "x" * 100_000, "x" * 200_000, "a b " * 20_000),
    *("1\n---\n2", "1\n...\n2", "1 # a comment", "1\n# a comment", "\n\n\n1", "a: b: c", "[", "{", '"', "]"),
    _SHAPES.format("[0, 0, 1e-300, 0.01]", _GOOD, _GOOD),
    _SHAPES.format("[0, 0, .nan, 0.01]", _GOOD, _GOOD),
    _SHAPES.format("[0.01, 0, 0, 0.01]", _GOOD, _GOOD),
    _SHAPES.format("[0, 0, 1e308, 0.01]", _GOOD, _GOOD),
    _SHAPES.format(", ".join([_GOOD] * 2000), _GOOD, _GOOD),
    _SHAPES.format("[0.02, 0.02, 0.03, 0.03]", "[-0.0005, -0.0005, 0.0005, 0.0005]", _GOOD),
    "[{name: '../x', rectangles: []}, 1, 2]",
)

FILES = (
    b"",
    b"# nothing",
    b"null",
    b"- scene",
    b"scene",
    b"3",
    b"scene:",
    b"scene: 3",
    b"scene: []",
    b"scene: {friction: 0.2}\nscene: {clearance_m: 0.002}",
    b"task:\n  n_holes: 3\n  n_holes: 3",
    b"scene: &s {self: *s}",
    b"a: &a [x, x]\nb: &b [*a, *a]\nc: &c [*b, *b]\nd: [*c, *c]",
    b"2020-01-01: {x: 1}",
    b"? [scene]\n: {friction: 1}",
    b"? {scene: 1}\n: 2",
    b"~: 1",
    b"1: 2",
    b"true: {}",
    b"<<: {scene: {friction: 1}}",
    b"!!map {scene: {}}",
    b"!!python/object:os.system {}",
    b"scene: {friction: 0.2}\n---\nscene: {friction: 0.3}",
    b"%YAML 1.1\n---\nscene: {friction: 010}",
    b"%YAML 1.2\n---\nscene: {friction: 01}",
    b"%TAG ! tag:x,2000:\n---\nscene: !y {}",
    b"\xef\xbb\xbfscene: {friction: 0.2}",
    "scene: {friction: 0.2}".encode("utf-16"),
    "scene: {friction: 0.2}".encode("utf-32"),
    b"scene: {friction: 0.2} # gr\xf6\xdfer",
    "scene: {friction: 0.2} # größer".encode(),
    b"scene:\n\tfriction: 0.2",
    b"scene:\r\n  friction: 0.2\r\n",
    b"scene: {friction: 0.2}\x00",
    b"\x00" * 1000,
    b"\xff\xfe\x00",
    b"[" * 100_000,
    b"{a: " * 30_000,
    b"- " * 60_000,
    b"? " * 60_000,
    b"a: " + b"x" * 10_000_000,
    b"scene: {friction: 0.3}\n" * 450_000,
    b"k: 1\n" * 20_000,
    b"\n" * 130_000,
    b"#\n" * 60_000,
    b"--- " * 30_000,
    b"&a " * 40_000,
    b"*" * 100_000,
    b"!" * 100_000,
    b"|\n" * 60_000,
    b"'" * 100_001,
    b"scene: " + b"'" + b"x" * 100_000 + b"'",
    b"x" * 100_000 + b": 1",
    b"scene: {" + b"y" * 100_000 + b": 1}",
    b"train: {epochs: " + b"9" * 100_000 + b"}",
)
