"""The grasp that holes share in an assembly: against the dense Gaussian, and through the table of a task."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fakes import FakeEngine

from mjx_fit.config.files import read_config
from mjx_fit.config.worlds import preset
from mjx_fit.scene import scenarios
from mjx_fit.scene.placement import GRASP, place_for_tool
from mjx_fit.task import methods
from mjx_fit.task.assembly import rounds
from mjx_fit.task.assembly_state import Table
from mjx_fit.task.shared_grasp import SharedGrasp, in_hand, places_for_tool
from mjx_fit.types import Belief
from mjx_fit.types.physics import Physics
from mjx_fit.utils.errors import RequestError

SHARED = ["filter.grasp_std_m=0.002", "task.n_holes=3"]
GRASPS = [f"randomize.grasp_{axis}_m={{uniform: [-0.003, 0.003]}}" for axis in "xy"]
CONFIG = read_config(None, [*SHARED, *GRASPS])
R, N = 4, 3


def detected(rng: np.random.Generator) -> Belief:
    """Return beliefs as the default detector makes them."""
    cov = np.broadcast_to(1e-4 * np.eye(2, dtype=np.float32), (R, N, 2, 2)).copy()
    return Belief(rng.normal(0, 0.1, (R, N, 2)).astype(np.float32), cov, np.zeros((R, N, 3), np.float32))


def test_what_a_row_learns_is_the_dense_gaussian_and_others_stay():
    rng = np.random.default_rng(0)
    before = detected(rng)
    shared = SharedGrasp(np.asarray(before.mean_world), CONFIG)
    rows, hole = np.array([1, 3]), np.array([0, 2])
    tried_hole = np.array([0, 0, 0, 2])
    mean = before.mean_world[np.arange(R), tried_hole] + np.float32(0.004)
    cov = np.broadcast_to(1e-5 * np.eye(2, dtype=np.float32), (R, 2, 2))
    shared.learn(rows, tried_hole, Belief(mean, cov, np.zeros((R, 3), np.float32)))
    after = shared.beliefs(before, np.ones(R, bool))
    np.testing.assert_allclose(after.mean_world[[0, 2]], before.mean_world[[0, 2]], atol=1e-7)
    # r_j = s_j - g: cov(r_j, r_i) is that of the grasp, 4e-6, and cov(r_i) is 1e-4.
    gain = 4e-6 / 1e-4
    for row, tried in zip(rows, hole, strict=True):
        for j in range(N):
            moved = 0.004 if j == tried else gain * 0.004
            np.testing.assert_allclose(after.mean_world[row, j] - before.mean_world[row, j], moved, rtol=1e-2)
            want = 1e-5 if j == tried else 1e-4 - gain**2 * (1e-4 - 1e-5)
            np.testing.assert_allclose(after.cov[row, j], want * np.eye(2), rtol=1e-3, atol=1e-9)
    shared.new_peg(rows)
    renewed = shared.beliefs(before, np.ones(R, bool))
    # The peg is forgotten: the hole is known as well as before the attempt but for the new grasp.
    other = (np.arange(N) != hole[0])[:, None]
    assert (np.abs(renewed.mean_world[1] - before.mean_world[1])[other[:, 0]] < 1e-6).all()
    assert (renewed.cov[1, hole[0], 0, 0] > 1e-5) & (renewed.cov[1, hole[0], 0, 0] < 1e-4)


def test_grasps_that_vary_more_than_what_is_believed_are_refused():
    config = read_config(None, ["filter.grasp_std_m=0.011"])
    with pytest.raises(RequestError, match=r"filter.grasp_std_m, grasp_std_rad: 0.011 and 0 are invalid"):
        SharedGrasp(np.zeros((R, N, 2), np.float32), config)


def test_a_peg_keeps_its_grasp_at_every_hole():
    rng = np.random.default_rng(1)
    values = {name: rng.uniform(-0.003, 0.003, (R, N)).astype(np.float32) for name in GRASP[:2]}
    physics = Physics(**values, friction=rng.uniform(0.2, 1, (R, N)).astype(np.float32))
    peg, hole = np.array([0, 1, 2, 0]), np.array([2, 2, 0, 1])
    own = in_hand(physics, peg, hole)
    np.testing.assert_array_equal(own.grasp_x_m, values["grasp_x_m"][np.arange(R), peg])
    np.testing.assert_array_equal(own.friction, np.asarray(physics.friction)[np.arange(R), hole])
    places = places_for_tool(rng.uniform(0.3, 0.5, (R, N, 2)).astype(np.float32), physics, CONFIG)
    assert places.shape == (R, N, N, 2)
    # The difference between two pegs is the same at every hole: that of their grasps.
    between = places[:, 0] - places[:, 1]
    np.testing.assert_allclose(between, np.broadcast_to(between[:, :1], between.shape), atol=1e-6)
    assert np.abs(between).max() > 1e-4


def test_an_assembly_judges_by_the_place_for_the_peg_in_hand_and_shares_what_it_learns():
    trials = scenarios.draw_trials(CONFIG, 0, np.arange(2))
    chosen = tuple(m for m in methods.ASSEMBLY if m.name in ("full", "oracle"))
    table = Table(CONFIG, chosen, trials, 0)

    def update(beliefs: Belief, felt, keys) -> Belief:
        mean = jnp.asarray(beliefs.mean_world) + 0.002
        cov = np.linalg.inv(np.linalg.inv(beliefs.cov) + np.eye(2) / 4e-6)
        return Belief(mean, jnp.asarray(cov, jnp.float32), jnp.asarray(beliefs.type_logp))

    shared_once = False
    for made in rounds(table, FakeEngine(), update):
        rows, chosen_hole = np.arange(4), np.asarray(made.chosen)
        for row in rows[made.before.active & ~np.asarray(made.rollouts.taken)][:2]:
            if row < 2:  # the method that learns
                others = np.arange(N) != chosen_hole[row]
                moved = made.learned.beliefs.mean_world[row] - made.before.beliefs.mean_world[row]
                np.testing.assert_allclose(moved[chosen_hole[row]], 0.002, atol=1e-6)
                if (made.before.peg == 0).all() and not shared_once:
                    np.testing.assert_allclose(moved[others], 0.04 * 0.002, rtol=0.02)
                shared_once = True
        for row in (2, 3):  # the oracle
            own = jax.tree.map(lambda leaf, row=row: leaf[row - 2 : row - 1], trials.physics)
            of_peg = in_hand(own, np.full((1, N), made.after.peg[row]), np.arange(N)[None])
            want = place_for_tool(trials.hole_pos_world[row - 2 : row - 1], of_peg, CONFIG)[0]
            if made.after.active[row]:
                np.testing.assert_allclose(made.after.beliefs.mean_world[row], want, atol=1e-6)
    assert shared_once


def test_without_grasps_an_assembly_is_the_same_with_the_joint_as_without():
    plain = read_config(None, ["task.n_holes=3"])
    tiny = read_config(None, ["task.n_holes=3", "filter.grasp_std_m=1e-9"])
    trials = scenarios.draw_trials(plain, 0, np.arange(3))
    full = tuple(m for m in methods.ASSEMBLY if m.name == "full")
    tables = [Table(config, full, trials, 0) for config in (plain, tiny)]

    def update(beliefs: Belief, felt, keys) -> Belief:
        mean, cov = jnp.asarray(beliefs.mean_world), jnp.asarray(beliefs.cov)
        return replace(beliefs, mean_world=mean + 0.002, cov=cov / 4)

    rows = []
    for table in tables:
        for _ in rounds(table, FakeEngine(), update):
            pass
        rows.append(table.rows())
    for one, other in zip(*rows, strict=True):
        assert one["attempts"] == other["attempts"]
        assert one["tried"] == other["tried"]


def test_a_return_starts_from_the_detection_with_the_grasp_as_it_is_known():
    rng = np.random.default_rng(2)
    before = detected(rng)
    shared = SharedGrasp(np.asarray(before.mean_world), CONFIG)
    tried, rows = np.zeros(R, int), np.arange(2)
    mean = before.mean_world[:, 0] + np.float32(0.004)
    cov = np.broadcast_to(1e-5 * np.eye(2, dtype=np.float32), (R, 2, 2))
    shared.learn(rows, tried, Belief(mean, cov, np.zeros((R, 3), np.float32)))
    back = shared.detections(before, np.ones(R, bool))
    gain = 4e-6 / 1e-4  # of the grasp, which is subtracted: every hole moves with it
    np.testing.assert_allclose((back.mean_world - before.mean_world)[:2], gain * 0.004, rtol=1e-2)
    np.testing.assert_allclose(back.mean_world[2:], before.mean_world[2:], atol=1e-7)
    want = 1e-4 - 4e-6 + 4e-6 - gain**2 * (1e-4 - 1e-5)
    np.testing.assert_allclose(back.cov[:2, :, 0, 0], want, rtol=1e-3)
    np.testing.assert_allclose(back.cov[2:], before.cov[2:], rtol=1e-5)


@pytest.mark.parametrize("world", ["bench", "home"])
def test_what_was_revealed_follows_the_peg_in_hand(world):
    """The bound of a perfect sensor is one for pegs that are held in other ways, too."""
    config = preset("gentle", world)
    config = replace(config, task=replace(config.task, n_holes=3))
    trials = scenarios.draw_trials(config, 0, np.arange(3))
    table = Table(config, tuple(m for m in methods.ASSEMBLY if m.name == "perfect_sensor"), trials, 0)
    seen = 0
    for made in rounds(table, FakeEngine(), lambda beliefs, felt, keys: beliefs):
        for row in np.flatnonzero(made.after.active & ~np.asarray(made.rollouts.taken)):
            hole, peg = made.chosen[row], np.full((1, N), made.after.peg[row])
            own = jax.tree.map(lambda leaf, row=row: leaf[row : row + 1], trials.physics)
            want = place_for_tool(
                trials.hole_pos_world[row : row + 1], in_hand(own, peg, np.arange(N)[None]), config
            )
            known = np.asarray(made.after.beliefs.cov)[row, :, 0, 0] < 1e-6
            np.testing.assert_allclose(made.after.beliefs.mean_world[row, known], want[0, known], atol=1e-6)
            seen += known[hole] + 10 * (known.any() and made.after.peg[row] > 0)
    assert seen > 20


def test_attempts_know_the_detection_however_often_the_belief_has_changed():
    """A belief that contact misled is wrong about the detection (``particles.misled_chance``)."""
    config = replace(CONFIG, filter=replace(CONFIG.filter, reads="geometry", grasp_std_m=0.0))
    trials = scenarios.draw_trials(config, 0, np.arange(3))
    table = Table(config, tuple(m for m in methods.ASSEMBLY if m.name == "full"), trials, 0)
    detections, moved = np.asarray(trials.estimate_world), []

    def update(beliefs: Belief, felt, keys) -> Belief:
        assert beliefs.memory is not None
        before = np.asarray(beliefs.memory.before.mean_world)
        apart = np.linalg.norm(detections - before[:, None], axis=-1)
        np.testing.assert_allclose(apart.min(1), 0, atol=1e-7)
        moved.append(np.linalg.norm(np.asarray(beliefs.mean_world) - before, axis=-1).max())
        return replace(beliefs, mean_world=jnp.asarray(beliefs.mean_world) + 0.002)

    for _ in rounds(table, FakeEngine(), update):
        pass
    assert moved[0] == 0
    assert max(moved) > 0.005
    remembers = replace(config, particles=replace(config.particles, remember=2))
    own = Table(remembers, tuple(m for m in methods.ASSEMBLY if m.name == "full"), trials, 0).next_try()
    assert own is not None
    assert own.beliefs.memory is None
