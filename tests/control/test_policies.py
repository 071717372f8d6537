import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.world import DetectorConfig, RandomConfig, SpiralConfig
from mjx_fit.control import open_loop, policies
from mjx_fit.scene.detector import detect
from mjx_fit.types import Attempt

QUIET = SpiralConfig(wiggle_m=0.0)


def seen_at(attempt, step, tip):
    """What a policy sees of a tip straight down that touches nothing."""
    down, still = jnp.array([0.0, 1, 0, 0]), jnp.zeros(3)
    wrench, contact = jnp.zeros((50, 6)), jnp.asarray(False)
    start, now = policies.start_of(attempt), jnp.asarray(step)
    own = jax.random.fold_in(attempt.key, now)
    return policies.PolicyInput(start, attempt.key, own, now, tip, down, still, still, wrench, contact, 100)


def command(attempt, step, tip):
    """The first command of the policy that the attempt names."""
    policy = open_loop.shipped(Config())
    state = policy.init(policies.start_of(attempt), attempt.key)
    return policy.act(state, seen_at(attempt, step, tip))[1]


def test_spiral_is_algorithm_4(key):
    x, p, J = np.array([0.51, -0.02]), np.array([0.5, -0.01]), 100
    for j in (0, 13, 50, 99):
        angle, radius = 2 * np.pi * j * 2 / J, j * 0.015 / J
        want = [radius * np.cos(angle) + p[0] - x[0], radius * np.sin(angle) + p[1] - x[1], -0.004]
        assert open_loop.spiral_command(jnp.asarray(j), J, jnp.asarray(x - p), key, QUIET) == pytest.approx(
            want, abs=1e-7
        )


def test_wiggle_has_sigma_and_lifts_only(key):
    keys = jax.random.split(key, 4000)
    zero = jnp.zeros(2)
    actions = jax.vmap(lambda k: open_loop.spiral_command(jnp.asarray(0), 100, zero, k, SpiralConfig()))(keys)
    assert np.std(actions[:, :2], 0) == pytest.approx([0.00125] * 2, rel=0.05)
    lift = actions[:, 2] + 0.004
    assert lift.min() >= 0
    assert lift.mean() == pytest.approx(0.00125 * np.sqrt(2 / np.pi), rel=0.05)


def test_random_policy_covers_its_reach_and_keeps_pressing(key):
    config = RandomConfig(wiggle_m=0.0)
    steps = jnp.arange(200)

    def goals(attempt_key):
        return jax.vmap(lambda j: open_loop.random_command(j, jnp.zeros(2), key, attempt_key, config))(steps)

    actions = np.asarray(jax.vmap(goals)(jax.random.split(key, 64)))
    assert np.abs(actions[..., :2]).max() <= config.reach_m
    assert np.abs(actions[..., :2]).max() > 0.9 * config.reach_m
    assert np.unique(np.sign(actions[..., 0]) + 3 * np.sign(actions[..., 1])).size >= 4
    assert (actions[..., 2] == np.float32(-config.push_m)).all()
    assert (
        np.abs(np.diff(actions[..., :2], axis=1)).max()
        <= 2 * config.reach_m / config.actions_per_sweep + 1e-7
    )


def test_draws_depend_on_the_attempt_alone(key):
    """The same attempt in batches of other sizes and orders acts the same, to the bit."""
    keys = jax.vmap(jax.random.fold_in, (None, 0))(key, jnp.arange(9))
    zeros = jnp.zeros(9, int)
    batch = Attempt(zeros, zeros, jnp.zeros((9, 2)), jnp.zeros((9, 2)), jnp.arange(9) % 2, keys)

    def act(attempts):
        return np.asarray(jax.vmap(lambda attempt: command(attempt, 7, jnp.zeros(3)))(attempts))

    whole = act(batch)
    picked = jax.tree.map(lambda leaf: leaf[np.array([5, 2])], batch)
    assert np.array_equal(act(picked), whole[[5, 2]])


@pytest.mark.parametrize("kind", ["square", "disc"])
def test_detector_has_the_stated_distribution(kind, key):
    hole = jnp.array([0.5, 0.1])
    config = DetectorConfig(kind=kind)
    draws = jax.vmap(lambda k: detect(k, hole, config))(jax.random.split(key, 20000))
    error = np.asarray(draws) - np.asarray(hole)
    distance = np.linalg.norm(error, axis=1)
    assert np.abs(error).max() <= 0.02 + 1e-7
    # E|(x, y)| on [-1, 1]^2 is 0.7652; a uniform radius has mean 1/2.
    assert distance.mean() == pytest.approx(0.02 * {"square": 0.7652, "disc": 0.5}[kind], rel=0.02)
    assert error.mean(0) == pytest.approx([0, 0], abs=3e-4)


def test_a_policy_goes_by_the_estimate_and_never_by_the_hole(key):
    """Spiral and random, as an attempt names them: the goal stays over the estimate, wherever the tip is."""
    config, estimate = Config(), np.array([0.5, 0.1], np.float32)
    step, here = jnp.asarray(7), np.array([0.503, 0.099, 0.05], np.float32)

    def act(hole, tip, policy):
        zero = jnp.asarray(0)
        attempt = Attempt(zero, zero, jnp.asarray(hole), jnp.asarray(estimate), jnp.asarray(policy), key)
        return np.asarray(command(attempt, step, jnp.asarray(tip)))

    own = jax.random.fold_in(key, step)
    relative = jnp.asarray(here[:2] - estimate)
    for policy, want in (
        (policies.SPIRAL, open_loop.spiral_command(step, 100, relative, own, config.spiral)),
        (policies.RANDOM, open_loop.random_command(step, relative, own, key, config.random)),
    ):
        got = act(estimate, here, policy)
        np.testing.assert_allclose(got, want, atol=1e-7)
        np.testing.assert_array_equal(act(estimate + 0.01, here, policy), got)
        moved = act(estimate, here + np.array([0.002, -0.001, 0.003], np.float32), policy)
        np.testing.assert_allclose(moved - got, [-0.002, 0.001, 0], atol=1e-7)


def test_sweeps_are_straight_lines_from_the_estimate_that_turn_at_their_last_action(key):
    config = RandomConfig(wiggle_m=0.0, actions_per_sweep=6)
    goals = np.asarray(
        jax.vmap(lambda j: open_loop.random_command(j, jnp.zeros(2), key, key, config))(jnp.arange(24))[
            :, :2
        ],
        float,
    )
    from_estimate = np.vstack([np.zeros(2), goals])  # before the first action
    bend = np.abs(np.diff(from_estimate, 2, axis=0)).max(1)  # at action j
    turns = np.arange(23) % 6 == 5
    assert bend[~turns].max() < 1e-7
    assert bend[turns].min() > 1e-4


def test_way_points_and_wiggles_are_independent(key):
    """A key used twice would make the wiggle of one action tell a way-point of a later one."""
    config, n = RandomConfig(actions_per_sweep=1, wiggle_m=0.0), 3000
    keys, steps = jax.random.split(key, n), jnp.arange(5)
    of_step = jax.vmap(jax.random.fold_in, (None, 0))

    def draws(attempt_key):
        goal = jax.vmap(lambda j: open_loop.random_command(j, jnp.zeros(2), key, attempt_key, config)[:2])(
            steps
        )
        wiggle = jax.vmap(lambda own: jax.random.normal(own, (3,)))(of_step(attempt_key, jnp.arange(7)))
        return jnp.concatenate([goal.ravel(), wiggle.ravel()])

    correlation = np.corrcoef(jax.vmap(draws)(keys), rowvar=False)
    assert np.abs(correlation - np.eye(len(correlation))).max() < 4.5 / np.sqrt(n)
