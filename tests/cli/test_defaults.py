"""What commands do when no option says otherwise, and what may not change with it."""

import json
from pathlib import Path

import pytest
import yaml
from places import EARLIER_RUN, EXPERIMENTS

from mjx_fit.cli import main, train_command
from mjx_fit.cli.options import config_of, run_of
from mjx_fit.cli.parser import parser
from mjx_fit.config.files import read_config, read_stored_config
from mjx_fit.config.schema import Config, config_differences, config_to_yaml
from mjx_fit.config.sections.learning import SensorConfig, TrainConfig
from mjx_fit.config.worlds import world_file
from mjx_fit.data.manifest import Manifest
from mjx_fit.data.plan import Plan, plan_of
from mjx_fit.training.checkpoint import load_sensor
from mjx_fit.utils import resources
from mjx_fit.utils.errors import RequestError


@pytest.fixture
def planned(monkeypatch):
    """The plan that a command line makes."""
    plans = []
    monkeypatch.setattr(
        "mjx_fit.data.collect.collect", lambda config, out, plan, engine, update, pool: plans.append(plan)
    )

    def plan(*options) -> Plan:
        assert main.main(["collect", "--out", "d", *options]) == 0
        return plans[-1]

    return plan


def test_collect_collects_spirals_as_long_as_an_attempt(planned):
    assert planned() == Plan()
    assert (Plan().policy, Plan().actions) == ("spiral", 100)
    assert Config().task.attempt_actions == 100
    assert planned("--set", "task.attempt_actions=40").actions == 40


def test_steps_is_another_name_of_actions(planned, capsys):
    assert planned("--actions", "7") == planned("--steps", "7") == Plan(actions=7)
    assert main.main(["collect", "--out", "d", "--actions", "7", "--steps", "8"]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "--steps: not allowed with argument --actions" in err
    with pytest.raises(SystemExit):
        parser().parse_args(["collect", "--help"])
    said = capsys.readouterr().out
    assert "--actions J" in said
    assert "--steps" not in said


def test_stored_requests_do_not_follow_the_defaults():
    """Bytes of shards and digests of manifests hold them; the key is still ``steps``."""
    stored = yaml.safe_load((EARLIER_RUN / "config.yaml").read_text())
    request = Plan(12, 7, "mixed", "native", 3, 4, 2).request(read_stored_config(EARLIER_RUN / "config.yaml"))
    kept = json.loads(json.dumps(request))["config"]
    followed = {
        f"{section}.{key}": kept[section][key]
        for section, keys in stored.items()
        for key, value in keys.items()
        if section not in ("sensor", "train") and key in kept[section] and kept[section][key] != value
    }
    assert followed == {}
    assert (kept["sensor"]["noise"], kept["train"]["epochs"]) == ("peg", 5000)  # the paper's, in all requests
    assert stored["scene"]["contact_width_m"] != Config().scene.contact_width_m

    plan = plan_of(Manifest(request, (1, 3), {}, ()))
    assert plan == Plan(12, 7, "mixed", "native", 3, 4, 2, shard_index=1, num_shards=3)
    assert "--actions 7 --policy mixed" in plan.command(Path("d"))
    assert "--steps" not in plan.command(Path("d"))


def test_train_without_a_preset_is_the_training_that_ships():
    ships = read_config(resources.folder("weights") / "config.yaml")
    cpu = read_config(resources.folder("configs") / "cpu.yaml")
    assert cpu == Config()
    assert (ships.sensor, ships.train) == (cpu.sensor, cpu.train)
    forge = read_config(world_file("forge"))
    same = ("scene", "control", "arm", "wrist", "pose", "detector", "randomize", "filter")
    differing = config_differences(ships, forge, lambda section, key: section in same)
    assert differing == ["scene.max_contacts is 8 there and 24 here"]  # slots of MJX; the data are from C
    fitted = json.loads((EXPERIMENTS / "robust" / "safeguards.json").read_text())["fitted"]
    assert fitted == {key: getattr(ships.filter, key) for key in fitted}


def test_presets_mean_what_they_meant():
    folder = resources.folder("configs")
    paper = read_config(folder / "paper.yaml")
    assert paper.sensor == SensorConfig(
        width=64,
        conv_channels=(16, 32, 64, 64, 64),
        layers=4,
        heads=4,
        feedforward=128,
        dropout=0.0,
        positional=False,
        causal=False,
        noise="peg",
        reference="estimate",
        contact_features=False,
        pose="world",
        places=0,
    )
    assert paper.train == TrainConfig(
        epochs=5000,
        batch_size=128,
        learning_rate=1e-4,
        schedule="constant",
        adam_b2=0.99,
        weight_decay=0.0,
        mirror=False,
        min_window=20,
        max_window=100,
        sequence=1,
        validation_fraction=0.1,
        patience=0,
        baseline_share=1.0,
    )
    quick = read_config(folder / "quick.yaml")
    assert config_differences(Config(), quick) == [
        "train.epochs is 50 there and 30 here",
        "train.baseline_share is 0.2 there and 0.0 here",
    ]
    demo = read_config(folder / "demo.yaml")
    assert config_differences(Config(), demo) == [
        "task.max_attempts is 30 there and 8 here",
        "task.outcome_model is constant there and covariance here",
    ]
    gentle = read_config(folder / "gentle.yaml")
    assert config_differences(Config(), gentle) == [
        "control.push is displacement there and force here",
        "random.reach_m is 0.025 there and 0.018 here",
        "task.next_hole is chance there and rate here",
        "task.revisit_from is belief there and detection here",
        "filter.match_temperature is 1.14 there and 2.0 here",
        "filter.position_temperature is 1.0 there and 1.35 here",
    ]


def test_seek_has_a_preset_and_weights_of_its_own():
    words = ["evaluate", "insertion", "--out", "a.json"]
    seek, spiral = (parser().parse_args([*words, *more]) for more in (["--policy", "seek"], []))
    assert config_of(seek) == read_config(resources.folder("configs") / "gentle.yaml")
    assert config_of(spiral) == Config()
    over = parser().parse_args([*words, "--policy", "seek", "--set", "control.push=displacement"])
    assert config_of(over).control == Config().control
    assert run_of(seek) == resources.folder("weights-gentle")
    assert run_of(spiral) == resources.folder("weights")
    assert run_of(spiral, "seek") == run_of(seek)


def test_other_trainings_are_named_with_files_that_exist(monkeypatch, tmp_path):
    for where in (resources.folder("configs").parent, tmp_path):
        monkeypatch.chdir(where)
        said = train_command.other_trainings()
        assert "\n" not in said
        for name in ("quick.yaml", "paper.yaml"):
            path = next(word for word in said.split() if word.endswith(name))
            assert (where / path).is_file()


def test_a_key_that_a_stored_run_lacks_means_what_it_meant_then(tmp_path):
    """``tests/earlier_run`` is older than noise, places and schedule."""
    folder = EARLIER_RUN
    stored = read_stored_config(folder / "config.yaml")
    assert (stored.sensor.noise, stored.sensor.contact_features, stored.sensor.places) == ("peg", False, 0)
    assert (stored.train.schedule, stored.train.mirror, stored.train.weight_decay) == ("constant", False, 0)
    assert (stored.sensor.width, stored.train.epochs) == (8, 2)
    load_sensor(folder)
    (tmp_path / "c.yaml").write_text(config_to_yaml(Config()))
    assert read_stored_config(tmp_path / "c.yaml") == Config()
    for text in ("sensor: 3", "train: {colour: 1}"):
        (tmp_path / "c.yaml").write_text(text)
        with pytest.raises(RequestError, match=r"^config: (sensor|train)"):
            read_stored_config(tmp_path / "c.yaml")
