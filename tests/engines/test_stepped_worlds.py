"""Worlds stepped from outside, against the engine's own rollouts."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mjx_fit.api import draw_attempts
from mjx_fit.config.schema import Config
from mjx_fit.control.policies import Policy
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.engines.native.worlds import Worlds

N, ACTIONS = 5, 6
FORCE = replace(Config(), control=replace(Config().control, push="force"))


def pressed(start, key):
    """Commands of an attempt: sideways by its own amount, and down."""
    return 0.002 * jax.random.normal(key, (ACTIONS, 3)) - jnp.array([0, 0, 0.005])


RECORDED = Policy(pressed, lambda commands, seen: (commands, commands[jnp.minimum(seen.step, ACTIONS - 1)]))


@pytest.mark.parametrize("config", [Config(), FORCE], ids=["displacement", "force"])
def test_each_world_goes_where_the_engine_takes_its_attempt_whenever_it_began(config):
    first, second = (draw_attempts(jax.random.key(i), N, config=config) for i in range(2))
    engine = NativeEngine(config, 2, RECORDED)
    wanted = [engine.run(attempts, ACTIONS) for attempts in (first, second)]
    commands = [np.asarray(jax.vmap(pressed, (None, 0))(None, attempts.key)) for attempts in (first, second)]

    worlds = Worlds(config, first, threads=2)
    early = np.array([True, False, True, False, False])  # these begin anew after two actions
    run, step = np.zeros(N, int), np.zeros(N, int)
    for number in range(ACTIONS):
        command = np.stack([commands[run[i]][i, step[i]] for i in range(N)])
        stepped = worlds.act(command)
        for i in range(N):
            felt = wanted[run[i]].felt
            trace, tare = felt.trace, felt.tare_sensor[i]
            np.testing.assert_allclose(
                stepped.row.tip_pos_world[i], trace.tip_pos_world[i, step[i]], atol=1e-6
            )
            wrench = trace.wrench_sensor[i, step[i]] - tare
            np.testing.assert_allclose(stepped.wrench_sensor[i], wrench, atol=0.02)
        step += 1
        if number == 1:
            worlds.restart(early, second)
            run[early], step[early] = 1, 0
            seen = worlds.seen()
            np.testing.assert_array_equal(seen.step, step)
            start = np.asarray(seen.start.estimate_world)
            want = np.where(early[:, None], second.estimate_world, first.estimate_world)
            np.testing.assert_array_equal(start, want)
            assert not np.asarray(seen.contact)[early].any()


def test_a_world_that_has_diverged_leaves_nothing_to_the_one_after_it():
    """The solver starts from the accelerations of the step before, which would stay not a number."""
    first, second = (draw_attempts(jax.random.key(i), 2, config=Config()) for i in range(2))
    worlds = Worlds(Config(), first, threads=1)
    worlds.act(np.zeros((2, 3)))
    (part,) = worlds._parts
    guess = part._block.batch.bind("qacc_warmstart")
    guess[:] = np.nan
    worlds.restart(np.array([True, False]), second)
    assert np.isfinite(guess[0]).all()
    assert np.isnan(guess[1]).all()
