"""Environments in MJX against those in MuJoCo's C engine, and the functional form."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

pytest.importorskip("gymnasium")

from mjx_fit.config.files import read_config
from mjx_fit.config.worlds import world_file
from mjx_fit.envs import InsertionVectorEnv
from mjx_fit.envs.functional import FunctionalInsertion
from mjx_fit.envs.observation import TURN_RAD
from mjx_fit.envs.reward import INSERTED

ACTIONS, N = 4, 3
SHORT = [f"task.attempt_actions={ACTIONS}", "spiral.radius_m=0.005"]


@pytest.mark.slow
@pytest.mark.parametrize("world", [None, "bench"], ids=["upright", "bench"])
def test_both_engines_lead_to_the_same_observations_and_rewards(world):
    """In the air and at the first contact; contacts then diverge, as in any two engines."""
    config = read_config(None if world is None else world_file(world), SHORT)
    one, other = (InsertionVectorEnv(N, config=config, engine=name) for name in ("native", "mjx"))
    seen = [env.reset(seed=2)[0] for env in (one, other)]
    np.testing.assert_allclose(seen[0], seen[1], atol=2e-3)
    action = np.full((N, 3 if world is None else 6), 0.2, np.float32)
    for step in range(ACTIONS + 1):  # and the first observation of the next episodes
        done = [env.step(action) for env in (one, other)]
        np.testing.assert_allclose(done[0][0], done[1][0], atol=0.05, err_msg=str(step))
        np.testing.assert_allclose(done[0][1], done[1][1], atol=0.02)
        np.testing.assert_array_equal(done[0][3], done[1][3])


@pytest.fixture(scope="module")
def played():
    """Two worlds straight down onto exact detections, for more than one episode; compiled once."""
    config = read_config(None, ["detector.half_width_m=0.00001", "task.attempt_actions=20"])
    env = FunctionalInsertion(config=config)
    down = jnp.tile(jnp.array([0.0, 0.0, 1.0]), (2, 1))

    @partial(jax.jit, compiler_options=env.compiler_options)
    def play(keys):
        begun = jax.vmap(env.reset)(keys)
        return begun, *jax.lax.scan(lambda state, _: jax.vmap(env.step)(state, down), begun, length=24)

    keys = jax.random.split(jax.random.key(3), 2)
    return env, play, keys, play(keys)


@pytest.mark.slow
def test_pegs_at_known_places_go_in_and_the_next_episode_begins(played):
    env, _, _, (begun, _, steps) = played
    steps = jax.tree.map(np.asarray, steps)
    assert steps.inserted.any(0).all()
    assert (steps.reward[steps.inserted] > INSERTED).all()
    for i in range(2):
        first = int(np.flatnonzero(steps.terminated[:, i])[0])
        assert np.abs(steps.observation[first, i] - steps.last_observation[first, i]).max() > 0.1
        np.testing.assert_array_equal(steps.observation[first - 1, i], steps.last_observation[first - 1, i])
        # The time begins anew; it comes before the types.
        time = steps.observation[:, i, -1 - env.config.scene.n_types]
        assert time[first] == 0
        assert time[first + 1] == pytest.approx(1 / 20)
    assert np.abs(begun.observation[0] - begun.observation[1]).max() > 0


@pytest.mark.slow
def test_a_world_depends_on_its_key_alone(played):
    _, play, keys, (_, _, steps) = played
    _, _, other = play(jnp.stack([keys[1], keys[0]]))
    np.testing.assert_allclose(other.observation[:8, ::-1], steps.observation[:8], atol=1e-3)


@pytest.mark.slow
def test_the_next_episode_is_at_another_hole(played):
    _, _, _, (begun, end, steps) = played
    assert (end.episode == steps.terminated.sum(0) + steps.truncated.sum(0)).all()
    apart = begun.now.attempt.hole_pos_world - end.now.attempt.hole_pos_world
    assert (jnp.abs(apart).max(-1) > 1e-4).all()


def test_on_the_bench_an_action_turns_the_tool_in_the_frame_of_the_estimate():
    """The observed rotation becomes the commanded one, whatever the estimate's own rotation is."""
    env = InsertionVectorEnv(2, config=read_config(world_file("bench"), ["task.attempt_actions=30"]))
    assert env.action_space.shape == (2, 6)
    start, _ = env.reset(seed=0)
    np.testing.assert_allclose(start[:, -3:], 0, atol=0.05)
    turn = np.array([0.0, 0.0, -1.0, 0.3, -0.2, 0.5], np.float32)
    for _ in range(15):
        seen = env.step(np.tile(turn, (2, 1)))[0]
    np.testing.assert_allclose(seen[:, -3:] * TURN_RAD, np.tile(turn[3:] * TURN_RAD, (2, 1)), atol=0.02)
