"""Scenes of 1, 2, 7 and 12 types: draws, requests, scenes, attempts, pictures."""

import collections
import dataclasses
import json
import subprocess
import sys
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fakes import FakeEngine
from synthetic import with_truth

from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config, config_from_tree, config_from_yaml, config_to_tree, config_to_yaml
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.config.sections.shape import SHAPES, Shape
from mjx_fit.config.sections.task import DEFAULT_ALPHA, TaskConfig
from mjx_fit.data.schedule import draw_attempts, pair_of, policy_of
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.evaluation import attempt, position, results
from mjx_fit.evaluation.request import Request
from mjx_fit.filters.outcome_model import constant_matrix, success_probability
from mjx_fit.scene import scenarios
from mjx_fit.scene.build import pair_index, simulation_scene
from mjx_fit.task import assembly, methods
from mjx_fit.task.assembly_state import Table
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.randomness import root_key
from mjx_fit.utils.type_colours import FIGURE_COLOURS, TYPE_RGB

TYPES = (1, 2, 7, 12)


def shapes(n: int) -> tuple[Shape, ...]:
    """Bars, each longer and narrower than the one before."""
    sizes = [(0.006 + 0.001 * i, 0.02 - 0.001 * i) for i in range(n)]
    return tuple(Shape(f"bar_{i}", ((-a, -b, a, b),)) for i, (a, b) in enumerate(sizes))


def config_of(n: int, **task) -> Config:
    return Config(scene=SceneConfig(shapes=shapes(n)), task=TaskConfig(**task))


@pytest.mark.parametrize("n", TYPES)
def test_sequences_take_all_pairs_evenly_and_policies_alternate_in_each(n):
    ids = np.arange(4 * n * max(1, n - 1) * 4)
    peg, hole = pair_of(ids, n)
    same, others = peg[ids % 2 == 0] == hole[ids % 2 == 0], peg[ids % 2 == 1] != hole[ids % 2 == 1]
    assert same.all()
    assert others.all() if n > 1 else not others.any()
    counts = collections.Counter(zip(peg.tolist(), hole.tolist(), strict=True))
    assert len(counts) == n * n
    for matched in (True, False):
        own = [count for (a, b), count in counts.items() if (a == b) == matched]
        assert len(set(own)) <= 1
    kind = policy_of("mixed", ids, 0, n)
    for pair in counts:
        seen = kind[(peg == pair[0]) & (hole == pair[1])]
        assert seen.mean() == 0.5


@pytest.mark.parametrize("n", [2, 12])
def test_policies_alternate_from_one_time_to_the_next_where_a_pair_comes_again_after_an_even_number(n):
    ids = np.arange(8 * n * (n - 1))
    peg, hole = pair_of(ids, n)
    kind = policy_of("mixed", ids, 0, n)
    for pair in {(0, 0), (0, 1), (1, 1)}:
        seen = kind[(peg == pair[0]) & (hole == pair[1])]
        assert (seen[1:] != seen[:-1]).all()


@pytest.mark.parametrize("n", TYPES)
def test_the_default_rates_of_other_shapes_are_the_mean_of_ours(n):
    config = config_of(n)
    assert constant_matrix(config) == pytest.approx(np.eye(n) * sum(DEFAULT_ALPHA) / 3, abs=1e-6)
    assert config_from_yaml(config_to_yaml(config)) == config
    assert Config().task.success_probability == DEFAULT_ALPHA
    covariance = replace(config, task=replace(config.task, outcome_model="covariance"))
    got = success_probability(covariance, jnp.eye(2) * 1e-6)
    assert (np.diag(got) > 0.9).all()
    assert np.asarray(got)[~np.eye(n, dtype=bool)].max(initial=0) == 0


MATRIX = ((0.3, 0.25), (0.0, 0.2))


@pytest.mark.parametrize("outcome_model", ["constant", "covariance"])
def test_pairs_that_do_not_match_keep_the_matrix_in_either_outcome_model(outcome_model):
    config = config_of(2, success_probability=MATRIX, outcome_model=outcome_model)
    got = np.asarray(success_probability(config, jnp.eye(2) * 4e-6))
    assert got[0, 1] == pytest.approx(0.25)
    assert got[1, 0] == 0


@pytest.mark.parametrize(
    ("rates", "what"),
    [
        ("[0.1, 0.2]", r"task.success_probability: \[0.1, 0.2\] is invalid: .* scene.shapes \(3\)"),
        ("[[0.1, 0, 0], [0, 0.1], [0, 0, 0.1]]", "one row per shape with one number per shape"),
        ("[[0.1, 0, 0], 0.1, [0, 0, 0.1]]", "one row per shape with one number per shape"),
        (
            "[[0.1, 0, 1.0], [0, 0.1, 0], [0, 0, 0.1]]",
            r"success_probability.0.2: 1.0 .* 0 to 0.999999",
        ),
        (
            "[[0.1, 0, 0], [0, 0, 0], [0, 0, 0.1]]",
            "success_probability.1.1: 0.0 is invalid: expected at least",
        ),
        ("[0, 0.1, 0.1]", "success_probability.0: 0 is invalid: expected a number from 1e-06"),
        ("[]", r"success_probability: \[\] is invalid: expected one entry for each"),
        ("x", "success_probability: 'x' is invalid: expected a list"),
    ],
)
def test_rates_that_are_no_matrix_of_the_shapes_are_refused(rates, what):
    with pytest.raises(RequestError, match=what):
        read_config(None, [f"task.success_probability={rates}"])


def test_one_to_twelve_shapes_are_allowed():
    tree = config_to_tree(config_of(12))["scene"]["shapes"]
    for wrong in ([], [*tree, {**tree[0], "name": "another"}]):
        with pytest.raises(
            RequestError, match=r"scene.shapes: \d+ entries given: expected at (least|most) 1"
        ):
            config_from_tree({"scene": {"shapes": wrong}})
    with pytest.raises(RequestError, match="names must differ"):
        config_from_tree({"scene": {"shapes": tree[:1] * 2}})


def test_a_scene_of_twelve_shapes_has_a_model_for_each_pair_and_runs():
    config = config_of(12)
    engine = NativeEngine(config, 1)
    scene = engine.scene
    assert (scene.n_types, len(scene.models)) == (12, 144)
    model, plain = scene.models[pair_index(11, 4, 12)], simulation_scene(SceneConfig(shapes=shapes(12)[4:5]))
    assert model.geom("peg_0").size[0] == pytest.approx(shapes(12)[11].rectangles[0][2])
    assert model.geom("hole_1").size == pytest.approx(plain.models[0].geom("hole_1").size)
    attempts = draw_attempts(jax.random.key(0), jnp.arange(20, 24), "spiral", config)
    assert set(np.asarray(attempts.peg_type).tolist()) == {0, 1, 10, 11}
    done = engine.run(attempts, 2)
    assert done.truth.valid.all()
    wrong = replace(attempts, peg_type=np.full(4, 12))
    with pytest.raises(RequestError, match="peg_type of row 0: 12 is invalid: expected 0 to 11"):
        engine.run(wrong, 2)


@pytest.mark.parametrize("n", TYPES)
def test_an_assembly_of_so_many_types_ends(n):
    config = config_of(n, n_holes=3, max_attempts=2)
    drawn = scenarios.draw_trials(config, 0, np.arange(3))
    table = Table(config, methods.ASSEMBLY[:1] + methods.ASSEMBLY[3:], drawn, 0)
    update = assembly.update_of_rows(config, (*methods.ASSEMBLY[:1], *methods.ASSEMBLY[3:]), 3, None)
    for _ in assembly.rounds(table, FakeEngine(), update):
        pass
    assert (table.pegs_done == 3).all()
    assert not any("inserted_wrongly" in row for row in table.rows())


@pytest.mark.parametrize("n", TYPES)
def test_single_holes_are_drawn_of_all_types(n, tmp_path):
    holes = position.draw_holes(config_of(n), np.arange(2 * n * n), n * n, root_key(0, "position"))
    matched = holes.peg_type == holes.hole_type
    assert matched[n * n :].all()
    assert matched[: n * n].any() == (n == 1)
    assert set(holes.peg_type.tolist()) == set(range(n))
    peg, hole = attempt._attempt_pairs(n * n, n)
    assert len(peg) == n**3 + (n * n if n > 1 else 0)
    assert len({*zip(peg.tolist(), hole.tolist(), strict=True)}) == n * n


class Loose(FakeEngine):
    """Every peg goes into every hole, at once."""

    def run(self, attempts, actions=None, active=None, horizon=None):
        done = super().run(attempts, actions, active, horizon)
        return with_truth(done, inserted=np.ones(len(done.felt.length), bool))


def test_a_peg_in_a_hole_of_another_type_is_used_up_and_neither_success_nor_help():
    config = config_of(2, n_holes=4)
    drawn = scenarios.draw_trials(config, 0, np.arange(5))
    chosen = methods.ASSEMBLY[:1]
    table = Table(config, chosen, drawn, 0)
    for round_ in assembly.rounds(table, Loose(), assembly.update_of_rows(config, chosen, 5, None)):
        last = round_
    assert (np.sort(last.after.content, axis=1) == np.sort(drawn.peg_type, axis=1)).all()
    rows, wrong = table.rows(), last.after.content != drawn.hole_type
    assert wrong.any()
    for row, own in zip(rows, wrong, strict=True):
        assert row["attempts"] == [1] * 4
        assert not any(row["human"])
        assert sum(row.get("inserted_wrongly", [])) == own.sum()
    summary = {row.metric: row.value for row in results.summarise_assembly(rows) if row.group == "all"}
    assert summary["inserted_wrongly"] == pytest.approx(wrong.mean())
    assert summary["intervention_rate"] == 0


SMALL_AND_BIG = (
    Shape("small", ((-0.008, -0.008, 0.008, 0.008),)),
    Shape("big", ((-0.02, -0.02, 0.02, 0.02),)),
)


def test_a_small_peg_in_a_big_hole_is_inserted_wrongly_and_no_success(tmp_path):
    config = Config(scene=SceneConfig(shapes=SMALL_AND_BIG))
    config = replace(config, detector=replace(config.detector, half_width_m=0.003))
    config = replace(config, task=replace(config.task, attempt_actions=40))
    request = Request(config, tmp_path / "attempt.json", NativeEngine(config, 1), 6)
    result = attempt.attempt(request)
    rows = {(row.metric, row.group): row for row in result.summary}
    assert rows["success_rate", "mismatched"].value == 0
    assert rows["inserted_wrongly", "small in big"].value > 0.5
    assert rows["inserted_wrongly", "small in big"].n == 3
    assert ("inserted_wrongly", "big in small") not in rows
    for trial in result.trials:
        if "inserted_wrongly" in trial:
            assert (trial["pair"], trial["inserted"]) == (["small", "big"], False)
    assert results.read(tmp_path / "attempt.json").trials == result.trials


def test_colours_differ_for_every_type():
    for colours in (FIGURE_COLOURS, TYPE_RGB):
        assert len(set(colours)) == 12


def test_three_other_shapes_keep_their_rates_when_replaced():
    config = Config()
    other = replace(config, scene=replace(config.scene, shapes=(*SHAPES[:2], shapes(1)[0])))
    assert other.task == config.task
    with pytest.raises(ValueError, match=r"scene.shapes \(2\), or null"):
        dataclasses.replace(config, scene=replace(config.scene, shapes=SHAPES[:2]))


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("n", [2, 7])
def test_from_data_to_video_end_to_end(n, tmp_path):
    """Every command once, as small as it gets."""
    scene, recipe = tmp_path / "scene.yaml", tmp_path / "recipe.yaml"
    scene.write_text(json.dumps({"scene": {"shapes": config_to_tree(config_of(n))["scene"]["shapes"]}}))
    network = {"width": 16, "conv_channels": [4] * 5, "layers": 1, "feedforward": 16}
    train = {"min_window": 5, "max_window": 20, "mirror": False, "epochs": 1}
    recipe.write_text(json.dumps({"sensor": network, "train": train}))
    few = "--set task.n_holes=2 --set task.max_attempts=2 --set task.attempt_actions=20"
    here = f"--config {scene} --engine native {few}"
    for command in (
        f"collect --out data --episodes {8 * n} --actions 20 --batch {8 * n} {here}",
        f"train --data data --out run --config {scene} --config {recipe}",
        f"evaluate assembly --out assembly.json --run run --trials 2 --methods full {here}",
        "report assembly.json run data --out page",
        "render assembly.json --run run --out film.gif --fps 2 --speed 20",
    ):
        line = [sys.executable, "-m", "mjx_fit", *command.split()]
        done = subprocess.run(line, check=False, capture_output=True, text=True, cwd=tmp_path)
        assert done.returncode == 0, (command, done.stderr[-2000:])
    assert (tmp_path / "page/index.html").stat().st_size > 10_000
    trial = results.read(tmp_path / "assembly.json").trials[0]
    assert set(trial["holes"]) <= set(config_of(n).scene.names)
