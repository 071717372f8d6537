"""YAML 1.2's core schema, and one line for everything else."""

import math
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjx_fit.config import strict_yaml
from mjx_fit.config.files import read_config
from mjx_fit.config.schema import config_from_yaml, config_to_yaml
from mjx_fit.config.strict_yaml import StrictYamlError
from mjx_fit.utils.errors import RequestError


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("010", 10),
        ("-007", -7),
        ("0o17", 15),
        ("0x1F", 31),
        ("+1", 1),
        ("1e-4", 1e-4),
        ("1.0e-05", 1e-5),
        ("12e03", 12000.0),
        (".5", 0.5),
        ("1.", 1.0),
        ("-.inf", -math.inf),
        ("true", True),
        ("False", False),
        ("~", None),
        ("null", None),
        ("", None),
        ("1:30", "1:30"),  # YAML 1.1: 90
        ("1_000", "1_000"),  # 1000
        ("0b11", "0b11"),  # 3
        ("yes", "yes"),  # True
        ("off", "off"),  # False
        ("2026-02-30", "2026-02-30"),  # an exception
        ("2020-01-01", "2020-01-01"),  # a date
        ("=", "="),  # an exception
        ("٣", "٣"),
        ("'010'", "010"),
        ("[1, {a: b}]", [1, {"a": "b"}]),
    ],
)
def test_values_mean_what_a_researcher_means(text, value):
    read = strict_yaml.load(f"a: {text}")["a"]
    assert read == value
    assert type(read) is type(value)
    assert type(strict_yaml.load(text)) is type(value)


def test_not_a_number_is_read_and_no_field_takes_it():
    assert math.isnan(strict_yaml.load(".nan"))
    with pytest.raises(RequestError, match=r"scene\.friction: nan is invalid"):
        read_config(None, ["scene.friction=.nan"])


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("a: 1\na: 2", "line 2, column 1: the key 'a' is given twice"),
        ("a: {b: 1, b: 2}", "the key 'b' is given twice"),
        ("a: [{b: {c: 1, 'c': 2}}]", "the key 'c' is given twice"),
        ("a: &s {self: *s}", "the anchor or alias 's'"),
        ("a: *s", "the anchor or alias 's'"),
        ("&k a: 1", "the anchor or alias 'k'"),
        ("<<: {a: 1}", "merge keys"),
        ("a: {<<: [1]}", "merge keys"),
        ("a: !!int x", "the tag 'tag:yaml.org,2002:int'"),
        ("a: !!float x", "the tag"),
        ("a: !!bool maybe", "the tag"),
        ("a: !!timestamp 2026-02-30", "the tag"),
        ("a: !!set {b}", "the tag"),
        ("a: !!python/object/apply:os.system [id]", "the tag"),
        ("!!map a: 1", "the tag"),
        ("a: ! b", "the tag '!'"),
        ("1: 2", "the key 1 is invalid: expected a name"),
        ("true: 2", "the key True"),
        ("~: 2", "the key None"),
        ("1.5: 2", "the key 1.5"),
        ("? [1, 2]\n: 3", r"the key \[1, 2\]"),
        ("? {a: 1}\n: 3", "the key {'a': 1}"),
        ("a: 1\n---\nb: 2", "line 2, column 1: a second document"),
        ("%YAML 1.1\n---\na: 1", "directives"),
        ("%TAG ! tag:x,2000:\n---\na: 1", "directives"),
        ("\ufeffa: 1", r"U\+FEFF"),
        ("a: \x00", r"line 1: the character U\+0000"),
        ("a:\n  b: \x1b[31m", r"line 2: the character U\+001B"),
        ("a: \ud800", r"U\+D800"),
        ('a: "\\0"', r"U\+0000"),
        ('a: "\\uD800"', r"U\+D800"),
        ('a: "\\UFFFFFFFF"', "an escape"),
        ('a: "\\U00110000"', "an escape"),
        (f"a: {'1' * 5000}", r"has too many digits \(5000\): expected at most 100"),
        (f"a: 0.{'1' * 5000}", r"has too many digits \(5002\)"),
        (f"a: 0x{'1' * 5000}", r"has too many digits \(5002\)"),
        (f"a: {'[' * 1000}", "expected at most 16 levels"),
        (f"a: {'{b: ' * 17}1{'}' * 17}", "expected at most 16 levels"),
        ("- " * 100, "expected at most 16 levels"),
        ("? " * 100, "expected at most 16 levels"),
        (f"a: [{'1,' * 20_000}]", "too many values: expected at most 10000"),
        ("x" * 10_000_000, "10000000 characters are too many: expected at most 131072"),
        ("a: [", "line 1, column 5: invalid YAML"),
        ("a: b: c", "invalid YAML"),
        ("a: @x", "invalid YAML"),
        ("a:\n\tb: 1", "invalid YAML"),
        ('a: "', "invalid YAML"),
        ("a: ]", "invalid YAML"),
    ],
)
def test_everything_else_is_one_short_line(text, word):
    began = time.process_time()
    with pytest.raises(StrictYamlError, match=word) as error:
        strict_yaml.load(text)
    assert time.process_time() - began < 1
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 300


@given(st.text(alphabet=st.sampled_from("ab01.:-?[]{},&*!|>'\"%@`#~<= \n\t\\u\x00é\ud800"), max_size=40))
def test_any_text_is_a_value_or_one_line(text):
    said = ""
    try:
        strict_yaml.load(text)
    except StrictYamlError as error:
        said = str(error)
    assert "\n" not in said


def test_sixteen_levels_are_read():
    value = strict_yaml.load("[" * 16 + "]" * 16)
    for _ in range(15):
        (value,) = value
    assert value == []


def test_files_are_utf_8_whatever_the_locale(tmp_path, monkeypatch):
    monkeypatch.setenv("LC_ALL", "C")
    path = tmp_path / "c.yaml"
    path.write_bytes("# größer\ntask: {n_holes: 3}".encode())
    assert read_config(path).task.n_holes == 3
    for content in (
        "task: {n_holes: 3}".encode("utf-16"),
        b"\xef\xbb\xbftask: {}",
        b"# gr\xf6\xdfer\ntask: {}",
    ):
        path.write_bytes(content)
        with pytest.raises(RequestError, match=r"c\.yaml cannot be read: .* is invalid"):
            read_config(path)


def test_paths_that_are_none_are_one_line(tmp_path):
    for path in ("a\0b", "x" * 5000, str(tmp_path), "new\nline", "\udcff"):
        with pytest.raises(RequestError, match=r"^config: .* cannot be read: ") as error:
            read_config(type(tmp_path)(path))
        assert str(error.value).isprintable()
        assert len(str(error.value)) < 400


def test_a_large_file_is_refused_before_it_is_read(tmp_path):
    (tmp_path / "c.yaml").write_text("scene: {friction: 0.3}\n" * 450_000)
    began = time.process_time()
    with pytest.raises(RequestError, match="too large: expected at most 131072 bytes"):
        read_config(tmp_path / "c.yaml")
    assert time.process_time() - began < 0.1


def test_a_section_twice_in_set_is_refused():
    with pytest.raises(RequestError, match="'name' is given twice"):
        read_config(None, ["scene.shapes=[{name: a, name: b}]"])


def test_what_to_yaml_wrote_is_read(tmp_path):
    shapes = (
        "[{name: 'no', rectangles: [[0, 0, 1e-2, 0.01]]}, {name: 'null', rectangles: [[0, 0, 0.01, 0.01]]}, "
        "{name: y, rectangles: [[0, 0, 0.01, 0.01]]}]"
    )
    odd = read_config(
        None, [f"scene.shapes={shapes}", "train.learning_rate=1e-12", "detector.half_width_m=5e-324"]
    )
    assert config_from_yaml(config_to_yaml(odd)) == odd
    assert odd.scene.names == ("no", "null", "y")
    with pytest.raises(RequestError, match="the key 'a' is given twice"):
        config_from_yaml("a: 1\na: 2")
