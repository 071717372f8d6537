"""Where second visits start: elsewhere than was searched in vain, and anew with another peg."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mjx_fit.config.files import read_config
from mjx_fit.data.schedule import draw_places
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.evaluation.single_hole_runner import holes_at
from mjx_fit.filters.updates import detected_belief
from mjx_fit.task import methods, single_hole
from mjx_fit.task.attempt_loop import Tried
from mjx_fit.task.revisits import Revisits

N = 3
SETTINGS = ["task.attempt_actions=25", "filter.capture_m=0.006", "filter.capture_chance=0.99"]
MAP, DETECTION = (
    read_config(None, [f"task.revisit_from={kind}", *SETTINGS]) for kind in ("map", "detection")
)
FULL = methods.chosen("full", methods.INSERTION)


def certain(beliefs, felt, keys):
    """Move the belief away, and take each hole for that of the first shape."""
    logp = np.log(np.tile(np.array([0.98, 0.01, 0.01], np.float32), (len(felt.length), 1)))
    return replace(beliefs, mean_world=beliefs.mean_world + np.float32(0.01), type_logp=logp)


def rounds_of(config, compared=FULL) -> list[Tried]:
    places = draw_places(jax.random.key(0), jnp.arange(N), config)
    holes = holes_at(np.zeros(N, int), np.ones(N, int), places)
    table = single_hole.HoleTable(config, compared, holes, 3)
    engine, seen = NativeEngine(config, 1), []
    while (asked := table.next_try()) is not None:
        rollouts = engine.run(asked.attempts, config.task.attempt_actions, asked.active)
        after = certain(asked.beliefs, rollouts.felt, asked.noise_keys)
        seen.append(Tried(asked, rollouts, after))
        table.record(seen[-1])
    return seen


@pytest.fixture(scope="module")
def visits():
    return {"map": rounds_of(MAP), "detection": rounds_of(DETECTION)}


def starts(seen: list[Tried]) -> np.ndarray:
    return np.stack([np.asarray(tried.asked.attempts.estimate_world) for tried in seen])


def test_the_first_visit_starts_from_the_detection(visits):
    np.testing.assert_allclose(starts(visits["map"])[0], starts(visits["detection"])[0], atol=1e-7)


def test_later_visits_start_away_from_where_pegs_have_been(visits):
    detection = starts(visits["detection"])
    np.testing.assert_allclose(detection[1:], detection[:1].repeat(2, 0), atol=1e-7)
    first, second, third = starts(visits["map"])
    for one, other in ((first, second), (second, third), (first, third)):
        assert np.linalg.norm(one - other, axis=1).min() > 0.001


def test_methods_that_learn_nothing_start_where_they_did():
    """Those that know the place, and those that always start from the detection, search by no map."""
    begun = starts(rounds_of(MAP, methods.chosen("no_update,oracle", methods.INSERTION)))
    np.testing.assert_allclose(begun[1:], begun[:1].repeat(2, 0), atol=1e-7)


def test_what_a_visit_felt_draws_the_next_one_unless_it_misled(visits):
    tried = visits["map"][0]
    first = np.asarray(tried.asked.attempts.estimate_world)
    detected = jax.tree.map(np.asarray, detected_belief(jnp.asarray(first), MAP))
    towards = []
    for misled in (0.01, 0.99):
        config = read_config(None, ["task.revisit_from=map", *SETTINGS, f"filter.misled_chance={misled}"])
        revisits = Revisits(detected, config)
        revisits.note((np.arange(N),), np.ones(N, bool), tried)
        now = revisits.started(detected, detected, np.ones(N, bool))
        towards.append((now.mean_world - first).sum(1))
    assert (towards[0] > 0.01).all()
    assert (towards[0] > towards[1]).all()


def test_another_peg_begins_anew_and_other_holes_keep_what_was_searched(visits):
    tried = visits["map"][0]
    detected = detected_belief(jnp.zeros((N, 2, 2)) + tried.asked.attempts.estimate_world[:, None], MAP)
    detected = jax.tree.map(np.asarray, detected)
    revisits, everywhere = Revisits(detected, MAP), np.ones((N, 2), bool)
    rows, failed = np.arange(N), np.array([True, True, False])
    revisits.note((rows, np.array([1, 0, 1])), failed, tried)

    def moved() -> np.ndarray:
        now = revisits.started(detected, detected, everywhere)
        return np.linalg.norm(now.mean_world - detected.mean_world, axis=-1) > 1e-4

    np.testing.assert_array_equal(moved(), [[False, True], [True, False], [False, False]])
    revisits.forget(np.array([0]))
    np.testing.assert_array_equal(moved(), [[False, False], [True, False], [False, False]])


def test_a_turned_frame_tells_the_same_path(visits):
    """The path is read in the frame of the estimate, and searched in the world's."""
    tried = visits["map"][0]
    turned = read_config(None, ["task.revisit_from=map", *SETTINGS, "filter.coordinates=[x, y, yaw]"])
    felt, rows = tried.rollouts.felt, (np.arange(N),)
    estimate = np.column_stack([felt.estimate_world, np.full(N, 0.5, np.float32)])
    askew = replace(tried, rollouts=replace(tried.rollouts, felt=replace(felt, estimate_world=estimate)))
    found = []
    for config, one, place in ((MAP, tried, felt.estimate_world), (turned, askew, estimate)):
        mean = jnp.asarray(place[:, :2])
        detected = detected_belief(mean, config)
        revisits = Revisits(jax.tree.map(np.asarray, detected), config)
        revisits.note(rows, np.ones(N, bool), one)
        found.append(revisits.started(detected, detected, np.ones(N, bool)).mean_world[:, :2])
    np.testing.assert_allclose(found[1], found[0], atol=1e-3)
    assert np.linalg.norm(found[0] - felt.estimate_world, axis=1).min() > 0.005
