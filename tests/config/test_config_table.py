"""The table of all keys, against the schema itself."""

import dataclasses
import json
from typing import get_origin

import pytest
from hostile import numbers

from mjx_fit.cli import main
from mjx_fit.config.schema import Config, config_to_tree
from mjx_fit.config.table import WIDTH, Key, as_text, keys
from mjx_fit.utils import resources

PURE = {
    *(
        "wrist.gain_error",
        "wrist.cross_talk",
        "filter.gate",
        "filter.match_temperature",
        "filter.position_temperature",
        "filter.correlation",
        "filter.capture_chance",
        "filter.misled_chance",
        "seek.astray_share",
        "seek.rock",
    ),
    *(
        "scene.friction",
        "scene.contact_damping",
        "scene.contact_impedance",
        "scene.deep_impedance",
        "control.damping_ratio",
        "task.success_probability",
        "task.success_by_error",
    ),
    *(
        f"particles.{key}"
        for key in [
            "count",
            "moves",
            "settle",
            "least_share",
            "outlier_chance",
            "row_weight",
            "remember",
            "remember_rows",
            "gap_spread",
            "misled_chance",
        ]
    ),
    *(
        f"sensor.{key}"
        for key in ["width", "conv_channels", "layers", "heads", "feedforward", "dropout", "places"]
    ),
    *(
        f"train.{key}"
        for key in ["learning_rate", "adam_b2", "weight_decay", "validation_fraction", "baseline_share"]
    ),
}
"""Numbers without a unit: a key that is added states one, or joins these."""


@pytest.fixture(scope="module")
def table() -> dict[str, Key]:
    return {f"{key.section}.{key.name}": key for key in keys(Config())}


def test_every_key_is_there_with_unit_and_description(table):
    tree = config_to_tree(Config())
    assert list(table) == [f"{section}.{key}" for section, values in tree.items() for key in values]
    for name, key in table.items():
        assert key.default == key.value == tree[key.section][key.name]
        assert len(key.description) > 5, name
        words = isinstance(key.default, bool | str) or name in ("scene.shapes", "filter.coordinates")
        assert (key.unit == "-") == words, name
    pure = {name for name, key in table.items() if key.unit == "1"}
    assert {name for name in pure if not name.startswith("randomize.")} == PURE
    for name, key in table.items():
        if key.section == "randomize" and name != "randomize.part_scale":
            (constant,) = (
                other
                for other in table.values()
                if other.name == key.name and other.section not in ("randomize", "moves")
            )
            assert key.unit == constant.unit, name
    assert table["scene.clearance_m"].unit == table["task.error_knots_m"].unit == "m"
    assert table["wrist.torque_z_noise_nm"].unit == "N·m"
    assert table["control.kp_position"].unit == "1/s²"


def test_ranges_are_those_of_the_schema(table):
    """``hostile.numbers`` reads the ends from pydantic's own metadata."""
    ends = {f"{section}.{key}": f"{low} to {high}" for section, key, _, low, high in numbers()}
    assert len(ends) > 40
    for name, allowed in ends.items():
        assert table[name].allowed.removesuffix(", by 4") == allowed
    assert table["sensor.width"].allowed == "4 to 512, by 4"
    assert table["sensor.conv_channels"].allowed == "5 x 1 to 512"
    assert table["task.error_knots_m"].allowed == "1-100 x 0 to 0.1"
    assert table["detector.kind"].allowed == "square, disc"
    assert table["train.mirror"].allowed == "true, false"


def test_a_line_for_each_key_and_none_is_wide(table):
    lines = as_text(list(table.values())).splitlines()
    assert max(map(len, lines)) <= WIDTH == 110
    assert [line.split()[0] for line in lines if line.startswith("  ")] == [
        key.name for key in table.values()
    ]
    assert not any("…" in line for line in lines)
    sections = [line.partition(":")[0] for line in lines[1:] if line and not line.startswith(" ")]
    assert sections == [field.name for field in dataclasses.fields(Config)]


def test_what_differs_from_the_defaults_is_shown(capsys):
    paper = str(resources.folder("configs") / "paper.yaml")
    argv = ["config", "--config", paper, "--set", "task.n_holes=3"]
    assert main.main(argv) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= WIDTH
    rows = {line.split()[0]: line.split() for line in lines if line.startswith("  ")}
    assert rows["n_holes"][1:7] == ["holes", "1", "to", "8", "5", "3"]
    assert rows["noise"][1:6] == ["-", "peg,", "trace", "trace", "peg"]
    assert main.main([*argv, "--json"]) == 0
    told = {f"{one['section']}.{one['name']}": one for one in json.loads(capsys.readouterr().out)}
    changed = {name for name, one in told.items() if one["value"] != one["default"]}
    assert {"task.n_holes", "sensor.noise", "train.epochs"} <= changed
    assert (told["task.n_holes"]["default"], told["task.n_holes"]["value"]) == (5, 3)
    assert "scene.clearance_m" not in changed


def test_descriptions_stay_beside_the_wide_values_of_a_world(capsys):
    assert main.main(["config", "--world", "forge"]) == 0
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("  ")]
    assert not any(line.endswith(" …") for line in rows)
    drawn = next(line for line in rows if "log_uniform [0.25, 1.25]" in line)
    assert drawn.split()[:4] == ["friction", "1", "distribution", "null"]
    assert drawn.endswith("Of scene.friction")


def test_a_key_that_does_not_exist_is_refused_by_the_table_as_by_all(capsys):
    assert main.main(["config", "--set", "scene.colour=1"]) == 2
    assert "unknown key" in capsys.readouterr().err


def test_choices_are_said_where_a_key_is_a_word(table):
    for name, key in table.items():
        schema = type(getattr(Config(), key.section))
        kind = next(field.type for field in dataclasses.fields(schema) if field.name == key.name)
        if get_origin(kind) is not None and isinstance(key.default, str):
            assert key.default in key.allowed.split(", "), name
