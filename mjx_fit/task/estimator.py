"""Update beliefs from failed attempts with sensors and filters (lines 9 to 11 of Algorithm 1)."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Bool, Float, Int, Key

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.filter import PLANAR
from mjx_fit.filters import chart
from mjx_fit.filters.frame import observation_in_world
from mjx_fit.filters.outcome_model import success_probability
from mjx_fit.filters.updates import prior_stds, update_position, update_type
from mjx_fit.sensors.contact_sensor import ContactSensor
from mjx_fit.sensors.reading import Window, read_window, without_errors
from mjx_fit.sensors.traces import require_readable
from mjx_fit.task.estimator_input import require_no_sensor, require_update
from mjx_fit.task.geometry import geometry_update
from mjx_fit.types import Array, Belief, Felt, Observation, Reading
from mjx_fit.utils import numerics
from mjx_fit.utils.errors import RequestError

Update = Callable[[Belief, Felt, Key[Array, "n"]], Belief]
"""Function that returns the posterior of n holes, given the measurements of a failed attempt at each.

The keys seed the noise of the simulated F/T sensor. An invalid field raises ``RequestError``.
"""


def filter_update(
    config: Config,
    sensor: ContactSensor | None,
    learns_position: Bool[np.ndarray, "n"] | bool = True,
    learns_type: Bool[np.ndarray, "n"] | bool = True,
    *,
    inserted: bool = False,
    logged: bool = False,
) -> Update:
    """Make the update of position and type from the outcome itself and from the sensor's observation.

    Args:
        config: Defines α, the noise of the F/T sensor and the height of the socket.
        sensor: The trained sensor; None: no row uses its trace, or the parts' geometry reads it
            (``filter.reads``).
        learns_position: Whether the trace updates the position; one value for all rows, or one per row.
        learns_type: Whether the trace updates the type, likewise; the outcome itself always does.
        inserted: Outcome of the attempts: False for failures; True for insertions, to tell whether the hole
            is the peg's own.
        logged: Whether a robot measured the traces: then they have its sensors' errors, and none are added.

    Raises:
        RequestError: There is a sensor, and the geometry of the parts is to read the traces.

    Example:
        >>> import mjx_fit as mf
        >>> sensor, holes = mf.load_sensor(), mf.draw_holes(0, 2)
        >>> update = mf.filter_update(sensor.config, sensor.network)
        >>> outcome = mf.try_holes(holes, {"full": update}, max_attempts=1)["full"]
        >>> outcome.mean_world.shape  # before and after the attempt
        (2, 2, 2)
    """
    numerics.require()
    reads_geometry = config.filter.reads == "geometry" and (np.any(learns_position) or np.any(learns_type))
    if reads_geometry:
        require_no_sensor(sensor)
    graph, state = nnx.split(sensor) if sensor is not None else (None, None)
    seen_as = without_errors(config) if logged else config
    by_geometry = geometry_update(config, seen_as) if reads_geometry else None

    def learn(state, beliefs, felt, keys, learns_position, learns_type):
        alpha = success_probability(config, beliefs.pos_cov)
        updated = update_type(
            beliefs, None, felt.peg_type, alpha, hard=config.task.hard_match, inserted=inserted
        )
        if by_geometry is not None:
            learnt = _outcome_learnt(by_geometry(beliefs, felt, keys), felt, alpha, config, inserted)
        elif graph is None:
            return updated
        else:
            observation = nnx.merge(graph, state)(readings(felt, keys, seen_as))
            observation = observation_in_world(observation, felt.estimate_world, config.filter.coordinates)
            learnt = posterior(beliefs, observation, felt.peg_type, alpha, config, inserted=inserted)
        return Belief(
            mean_world=where_rows(learns_position, learnt.mean_world, beliefs.mean_world),
            cov=where_rows(learns_position, learnt.cov, beliefs.cov),
            type_logp=where_rows(learns_type, learnt.type_logp, updated.type_logp),
            memory=jax.tree.map(partial(where_rows, learns_position), learnt.memory, beliefs.memory),
        )

    compiled = jax.jit(learn)

    def update(beliefs: Belief, felt: Felt, keys: Key[Array, "n"]) -> Belief:
        require_update(beliefs, felt, keys, config)
        n = len(felt.length)
        # Traced, not constants: one compilation serves rows with any traits.
        position, kind = (np.broadcast_to(one, n).copy() for one in (learns_position, learns_type))
        return compiled(state, beliefs, felt, keys, position, kind)

    return update


def _outcome_learnt(
    beliefs: Belief, felt: Felt, alpha: Float[Array, "n C C"], config: Config, inserted: bool
) -> Belief:
    """Return beliefs whose types know the outcome, those before remembered attempts as well."""

    def learnt(belief: Belief) -> Belief:
        hard = config.task.hard_match
        return update_type(belief, None, felt.peg_type, alpha, hard=hard, inserted=inserted)

    memory = beliefs.memory
    if memory is not None:
        memory = replace(memory, before=learnt(memory.before))
    return replace(learnt(beliefs), memory=memory)


def posterior(
    beliefs: Belief,
    observation: Observation,
    peg_type: Int[Array, "*batch"],
    success_probability: Float[Array, "*#batch C C"],
    config: Config,
    *,
    inserted: bool = False,
) -> Belief:
    """Update beliefs with observations, for any batch axes.

    Args:
        beliefs: Prior of each hole.
        observation: Output of the virtual sensors.
        peg_type: Type of the peg in hand.
        success_probability: Outcome model α; zeros while an attempt lasts, whose outcome is open.
        config: Defines the safeguards of the filters.
        inserted: As in ``filter_update``.

    Raises:
        RequestError: The sensor knows another number of types.
    """
    _require_same_types(observation, config)
    observation = replace(
        observation,
        match_logits=observation.match_logits / config.filter.match_temperature,
        pos_noise_cov=observation.pos_noise_cov * config.filter.position_temperature,
    )
    moved = update_position(beliefs, observation, config.filter, prior_stds(config))
    hard = config.task.hard_match
    typed = update_type(beliefs, observation, peg_type, success_probability, hard=hard, inserted=inserted)
    return replace(moved, type_logp=typed.type_logp)


def position_update(config: Config, sensor: ContactSensor) -> Update:
    """Make the update that knows only of positions: height and rotations stay as they were detected.

    Where only x and y are believed it is ``filter_update``.
    """
    numerics.require()
    graph, state = nnx.split(sensor)
    flat = replace(config, filter=replace(config.filter, coordinates=PLANAR))

    @jax.jit
    def learn(state, beliefs: Belief, felt: Felt, keys: Key[Array, "n"]) -> Belief:
        seen = nnx.merge(graph, state)(readings(felt, keys, config))
        seen = observation_in_world(seen, felt.estimate_world, config.filter.coordinates)
        seen = replace(
            seen, innovation=seen.innovation[..., :2], pos_noise_cov=seen.pos_noise_cov[..., :2, :2]
        )
        before = replace(beliefs, mean_world=beliefs.pos_mean_world, cov=beliefs.pos_cov)
        alpha = success_probability(config, beliefs.pos_cov)
        after = posterior(before, seen, felt.peg_type, alpha, flat)
        return Belief(
            mean_world=jnp.asarray(beliefs.mean_world).at[..., :2].set(after.mean_world),
            cov=jnp.asarray(beliefs.cov).at[..., :2, :2].set(after.cov),
            type_logp=after.type_logp,
        )

    def update(beliefs: Belief, felt: Felt, keys: Key[Array, "n"]) -> Belief:
        require_update(beliefs, felt, keys, config)
        return learn(state, beliefs, felt, keys)

    return update


def frame_update(config: Config, sensor: ContactSensor) -> Update:
    """Make the update of the frame-by-frame baseline: estimate and R from the last attempt alone."""
    numerics.require()
    graph, state = nnx.split(sensor)

    @jax.jit
    def learn(state, beliefs: Belief, felt: Felt, keys: Key[Array, "n"]) -> Belief:
        seen = nnx.merge(graph, state)(readings(felt, keys, config))
        _require_same_types(seen, config)
        coordinates = config.filter.coordinates
        seen = observation_in_world(seen, felt.estimate_world, coordinates)
        mean = chart.moved(felt.estimate_world, seen.innovation, coordinates)
        return replace(beliefs, mean_world=mean, cov=seen.pos_noise_cov)

    def update(beliefs: Belief, felt: Felt, keys: Key[Array, "n"]) -> Belief:
        require_update(beliefs, felt, keys, config)
        return learn(state, beliefs, felt, keys)

    return update


def readings(
    felt: Felt, keys: Key[Array, "n"], config: Config, count: Int[Array, ""] | None = None
) -> Reading:
    """Compute the sensors' input from attempts (n,): tared, with F/T sensor noise drawn from these keys.

    Args:
        felt: The attempts.
        keys: Seeds of the noise.
        config: Defines the noise of the F/T sensor and the scene.
        count: Number of actions to read; the rest is padding, for a single compilation. None: all.

    Raises:
        RequestError: A trace is invalid (``mjx_fit.sensors.traces``).

    Example:
        >>> import jax, mjx_fit as mf
        >>> felt = mf.make_engine("native").run(mf.draw_attempts(jax.random.key(0), 2), actions=3).felt
        >>> mf.readings(felt, jax.random.split(jax.random.key(1), 2), mf.Config()).pressure_tip.shape
        (2, 3, 2)
    """
    require_readable(felt, config.scene.n_types, d=len(config.filter.coordinates))
    rows = felt.trace.action_world.shape[1]

    def one(attempt: Felt, key: Key[Array, ""]) -> Reading:
        return read_window(attempt, key, config, Window(rows, count=count))

    return jax.vmap(one)(felt, keys)


def _require_same_types(observation: Observation, config: Config) -> None:
    known = observation.match_model_logp.shape[-2]
    if known != config.scene.n_types:
        raise RequestError(
            f"sensor: {known} types cannot be used: scene.shapes has {config.scene.n_types}; train a sensor "
            "on these shapes"
        )


def where_rows(condition: Bool[Array, "n"], new: Array, old: Array) -> Array:
    """Select the new or the old value row by row."""
    return jnp.where(condition.reshape(-1, *[1] * (new.ndim - 1)), new, old)
