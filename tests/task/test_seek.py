"""The policy that acts on its belief while it touches: against the filter, and against its rule by hand."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fakes import FakeEngine, seen
from flax import nnx
from thoughts import belief_of, thought

from mjx_fit.api import draw_attempts
from mjx_fit.config.schema import Config
from mjx_fit.control import search
from mjx_fit.control.policies import PolicyStart
from mjx_fit.engines.select import make_engine
from mjx_fit.evaluation.request import Request
from mjx_fit.filters.updates import initial_belief
from mjx_fit.sensors.contact_sensor import ContactSensor
from mjx_fit.sensors.reading import Window, read_window
from mjx_fit.task.after_attempts import after_failures
from mjx_fit.task.estimator import posterior
from mjx_fit.task.seek import NAME, Thought, decided, seek
from mjx_fit.types import Belief
from mjx_fit.utils.errors import RequestError

N, ACTIONS = 4, 12
NEVER, AT_ONCE = 0.0, 1e6


def without_errors(config: Config) -> Config:
    return replace(config, wrist=config.wrist.without_errors(), pose=config.pose.without_errors())


def gentle(**sensor) -> Config:
    config = without_errors(Config())
    small = replace(config.sensor, width=16, layers=1, heads=2, conv_channels=(4,) * 5, **sensor)
    return replace(config, sensor=small, control=replace(config.control, push="force"))


def a_sensor(config: Config) -> ContactSensor:
    """A sensor whose answers depend on the trace: its last layers are not those of an untrained one."""
    sensor = ContactSensor(config.sensor, nnx.Rngs(3))
    rngs = nnx.Rngs(4)
    for head in (sensor.position, sensor.match):
        head.last.kernel[...] = 2.0 * jax.random.normal(rngs.params(), head.last.kernel.shape)
    return sensor


@pytest.mark.parametrize("engine", ["native", pytest.param("mjx", marks=pytest.mark.slow)])
def test_the_belief_inside_an_attempt_is_the_filters_after_the_trace_so_far(engine):
    config = gentle(causal=True)
    sensor = a_sensor(config)
    attempts = draw_attempts(jax.random.key(1), N, config=config)
    offset = jnp.array([0.003, -0.002])  # an attempt may start elsewhere than at the mean
    prior = Belief(
        attempts.estimate_world - offset,
        jnp.broadcast_to(jnp.diag(jnp.array([4e-6, 9e-6])), (N, 2, 2)),
        jnp.log(jnp.broadcast_to(jnp.array([0.2, 0.3, 0.5]), (N, 3))),
    )
    attempts = replace(attempts, belief=prior)
    done = make_engine(engine, config, seek(config, sensor)).run(attempts, ACTIONS)
    # Before the first reading it is the prior; row j of the report has read j actions.
    for got, want in zip(jax.tree.leaves(done.report), jax.tree.leaves(prior), strict=True):
        np.testing.assert_allclose(got[:, 0], want, rtol=1e-6)
    moved = 0.0
    for j in range(1, int(np.min(done.felt.length))):
        window = Window(ACTIONS, count=j)
        reading = jax.vmap(lambda felt, w=window: read_window(felt, jax.random.key(0), config, w))(done.felt)
        observed = sensor(reading)
        observed = replace(observed, innovation=observed.innovation + offset)
        want = posterior(prior, observed, done.felt.peg_type, jnp.zeros((3, 3)), config)
        got = jax.tree.map(lambda leaf, j=j: leaf[:, j], done.report)
        np.testing.assert_allclose(got.pos_mean_world, want.pos_mean_world, atol=2e-6)
        np.testing.assert_allclose(got.pos_cov, want.pos_cov, rtol=1e-3)
        np.testing.assert_allclose(got.type_logp, want.type_logp, atol=1e-3)
        moved = np.abs(want.pos_mean_world - prior.pos_mean_world).max()
    assert moved > 1e-4


def costs(thought: Thought, here, config: Config) -> tuple[float, float]:
    """The two times of the rule, from 200,000 drawn holes."""
    own, b = config.seek, thought.belief
    rng = np.random.default_rng(0)
    holes = rng.multivariate_normal(np.asarray(b.pos_mean_world), np.asarray(b.pos_cov, float), 200_000)
    area = np.square(holes - np.asarray(thought.search.centre_world)).sum(1)
    area -= own.pitch_m * float(thought.search.path_m) / np.pi
    way = np.linalg.norm(np.asarray(b.pos_mean_world) - here[:2])
    per_area = np.pi / (own.speed_mps * own.pitch_m)
    anew = own.change_s + way / own.slide_mps + per_area * float(np.trace(b.pos_cov))
    goes_on = per_area * np.maximum(area, 0).mean() + (area < 0).mean() * (own.change_s + anew)
    return float(goes_on), float(anew)


def test_a_search_is_begun_anew_where_that_takes_less_time():
    config, outcomes = Config(), []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        belief = belief_of(rng.normal(0, 0.004, 2), rng.uniform(0.002, 0.006))
        centre = np.asarray(belief.pos_mean_world) + rng.normal(0, 0.0015, 2)
        before = thought(belief, path_m=rng.uniform(0, 0.06), centre=centre)
        here = (*rng.normal(0, 0.006, 2), 0.045)
        goes_on, anew = costs(before, here, config)
        if abs(goes_on - anew) < 0.04 * anew:
            continue  # too close for drawn holes
        after = decided(before, seen(here), config)
        if anew < goes_on:
            np.testing.assert_allclose(after.search.centre_world, belief.pos_mean_world, rtol=1e-6)
            assert float(after.search.path_m) == 0
        else:
            assert float(after.search.path_m) == float(before.search.path_m)
        outcomes.append(anew < goes_on)
    assert 3 <= sum(outcomes) <= len(outcomes) - 3


def test_nothing_is_decided_before_contact_or_in_a_hole():
    config, belief = Config(), belief_of((0.01, 0.0), 0.001, match=0.01)
    start = PolicyStart(jnp.int32(0), jnp.zeros(2), jnp.int32(2), elsewhere_per_s=jnp.asarray(AT_ONCE))
    now = replace(seen(), start=start)
    deep = thought(belief, path_m=0.01)
    deep = replace(deep, search=replace(deep.search, dropped=jnp.asarray(True)))
    for state in (thought(belief, path_m=0.01, touched=False), deep):
        after = decided(state, now, config)
        assert not after.leaves
        assert float(after.search.path_m) == pytest.approx(0.01)


@pytest.mark.parametrize("match", [0.9, 0.05])
def test_a_hole_is_left_where_another_promises_more_insertions_per_second(match):
    config, belief = Config(), belief_of((0.0005, 0.0), 0.001, match)
    state = thought(belief, path_m=0.002)
    here = match / float(search.insertion_s(jnp.asarray(min(costs(state, np.zeros(3), config))), config.seek))
    for factor in (0.9, 1.1):
        start = PolicyStart(
            jnp.int32(0), jnp.zeros(2), jnp.int32(2), elsewhere_per_s=jnp.asarray(here * factor)
        )
        assert bool(decided(state, replace(seen(), start=start), config).leaves) == (factor > 1)


@pytest.mark.parametrize(("elsewhere", "ends"), [(NEVER, False), (AT_ONCE, True)])
def test_an_attempt_ends_when_its_hole_is_left(elsewhere, ends):
    config = gentle(causal=True)
    attempts = draw_attempts(jax.random.key(1), N, config=config)
    attempts = replace(attempts, elsewhere_per_s=jnp.full(N, elsewhere))
    done = make_engine("native", config, seek(config, a_sensor(config))).run(attempts, ACTIONS)
    assert ((done.felt.length < ACTIONS) == ends).all()


def test_a_search_without_a_sensor_inserts_from_a_millimetre_off():
    config = gentle()
    attempts = draw_attempts(jax.random.key(2), 8, config=config)
    start = attempts.hole_pos_world + 0.0015 * jnp.array([0.8, -0.6])
    attempts = replace(attempts, hole_type=attempts.peg_type, estimate_world=start)
    done = make_engine("native", config, seek(config)).run(attempts, 60)
    assert np.mean(done.truth.inserted) >= 0.75


@pytest.mark.parametrize("lasts", [False, True])
def test_the_last_belief_of_the_policy_is_the_posterior_of_a_failed_attempt(lasts):
    """One that lasts to its end has refuted where it believed the hole to be."""
    config, actions = gentle(causal=True), 4
    attempts = draw_attempts(jax.random.key(1), N, config=config)
    attempts = replace(attempts, elsewhere_per_s=jnp.full(N, NEVER if lasts else AT_ONCE))
    done = make_engine("native", config, seek(config, a_sensor(config))).run(attempts, actions + 3)
    if not lasts:
        assert (done.felt.length < actions + 3).all()
    prior = initial_belief(attempts.estimate_world, config.detector.prior_std_m, 3)

    def never(beliefs, felt, keys):
        raise AssertionError("the trace must not be read again")

    after = after_failures(never, prior, done, attempts.key)
    last = np.asarray(done.felt.length) - 1
    assert np.asarray(done.truth.failed).all()
    for name in ("mean_world", "cov", "type_logp"):
        told = getattr(done.report, name)
        now, old = (np.asarray(getattr(belief, name)) for belief in (after, prior))
        want = old if lasts and name != "type_logp" else told[np.arange(N), last]
        np.testing.assert_array_equal(now, want)


@pytest.mark.parametrize("methods", ["no_update", "full,sample"])
def test_methods_that_learn_less_than_seek_are_not_compared_under_its_name(methods, tmp_path):
    engine = FakeEngine()
    engine.policy_name = f"{NAME}@0123456789ab"
    request = Request(Config(), tmp_path / "a.json", engine, 2, methods=methods)
    with pytest.raises(RequestError, match=f"--methods: {methods.split(',')[-1]} cannot be used with"):
        request.asked_policy()
    assert replace(request, methods="full,oracle").asked_policy() == {"policy": engine.policy_name}


def test_a_sensor_that_reads_whole_attempts_only_is_refused():
    config = gentle()
    with pytest.raises(RequestError, match=r"sensor\.causal"):
        seek(config, ContactSensor(config.sensor, nnx.Rngs(0)))
