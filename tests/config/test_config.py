from dataclasses import replace

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config, config_differences, config_to_yaml
from mjx_fit.config.sections.cross_section import Circle, CrossSection
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.config.sections.shape import Shape
from mjx_fit.config.sections.task import TaskConfig
from mjx_fit.utils import resources
from mjx_fit.utils.errors import RequestError


def test_yaml_round_trip(tmp_path):
    changed = read_config(None, ["scene.clearance_m=0.002", "detector.kind=disc", "task.n_holes=3"])
    (tmp_path / "c.yaml").write_text(config_to_yaml(changed))
    assert read_config(tmp_path / "c.yaml") == changed
    assert changed != Config()


@given(st.floats(0.0001, 0.005))
def test_floats_survive(value):
    assert read_config(None, [f"scene.clearance_m={value!r}"]).scene.clearance_m == value


def test_numbers_without_a_point_are_numbers():
    assert read_config(None, ["train.learning_rate=1e-3"]).train.learning_rate == 1e-3


def test_later_files_win_key_by_key(tmp_path):
    (tmp_path / "a.yaml").write_text("task: {n_holes: 3, max_attempts: 9}")
    (tmp_path / "b.yaml").write_text("task: {n_holes: 4}\nscene: {clearance_m: 0.002}")
    both = read_config([tmp_path / "a.yaml", tmp_path / "b.yaml"], ["task.attempt_actions=7"])
    assert (both.task.n_holes, both.task.max_attempts, both.task.attempt_actions) == (4, 9, 7)
    assert both.scene.clearance_m == 0.002
    with pytest.raises(RequestError, match=r"no\.yaml cannot be read: No such file or directory$"):
        read_config([tmp_path / "a.yaml", tmp_path / "no.yaml"])
    with pytest.raises(RequestError, match=r"^config: scene\.shapes: 0 entries given: expected at least 1$"):
        read_config(None, ["scene.shapes=[]"])


def test_every_shipped_config_is_valid():
    files = list(resources.folder("configs").glob("*.yaml"))
    assert {path.stem for path in files} >= {"quick", "paper"}
    for path in files:
        read_config(path)
        assert yaml.safe_load(path.read_text())


def test_overrides_win_over_the_file(tmp_path):
    (tmp_path / "c.yaml").write_text("task: {n_holes: 2}")
    assert read_config(tmp_path / "c.yaml", ["task.n_holes=4"]).task.n_holes == 4


@pytest.mark.parametrize(
    "text", ["- a list", "scene: [", "scene: 3", "task: {n_holes: 2.5}", "train: {epochs: 0}"]
)
def test_bad_files_are_one_line(tmp_path, text):
    (tmp_path / "c.yaml").write_text(text)
    with pytest.raises(RequestError) as error:
        read_config(tmp_path / "c.yaml")
    assert "\n" not in str(error.value)


def test_the_plate_must_be_wider_than_where_a_peg_may_come():
    assert read_config(None, ["detector.half_width_m=0.03"]).detector.half_width_m == 0.03
    for wide in (["detector.half_width_m=0.03", "spiral.radius_m=0.02"], ["spiral.radius_m=0.032"]):
        with pytest.raises(RequestError, match="is invalid: expected at least"):
            read_config(None, wide)
        read_config(None, [*wide, "scene.plate_half_width_m=0.1"])


def test_of_many_known_keys_the_most_similar_are_listed():
    with pytest.raises(RequestError) as error:
        read_config(None, ["randomize.frction=null"])
    assert "unknown key; allowed here: friction, " in str(error.value)
    assert str(error.value).endswith("more; mjx-fit config lists them")


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ("{circle: {diametre_m: 0.008}}", r"circle\.diametre_m: unknown key; allowed here: diameter_m"),
        (
            "{union: [{cirlce: {diameter_m: 0.008}}]}",
            r"union\.0\.cirlce: unknown key; allowed here: circle",
        ),
        ("{circle: {}}", r"circle\.diameter_m: it is missing"),
    ],
)
def test_a_mistyped_key_is_named_at_any_depth(section, said, tmp_path):
    file = tmp_path / "part.yaml"
    file.write_text(f"scene: {{shapes: [{{name: one, section: {section}}}]}}")
    with pytest.raises(RequestError, match=said):
        read_config([file])


def test_differences_of_parts_name_the_part_and_the_key():
    """Sections are long lists of numbers: they are named and not printed."""
    pin = Shape("pin", section=CrossSection(circle=Circle(0.008)), clearance_m=0.0001)
    config = replace(Config(), scene=SceneConfig(shapes=(pin,)), task=TaskConfig())
    for other, word in (
        (replace(pin, clearance_m=0.0003), "scene.shapes: pin.clearance_m is 0.0001 there and 0.0003 here"),
        (replace(pin, name="pen"), "scene.shapes is pin there and pen here"),
        (
            replace(pin, section=CrossSection(circle=Circle(0.009))),
            "scene.shapes: section of pin is another there than here",
        ),
    ):
        changed = replace(config, scene=SceneConfig(shapes=(other,)), task=TaskConfig())
        assert config_differences(config, changed) == [word]
