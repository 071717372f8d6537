"""Policy ``seek``: search about the believed position, update the belief with every action, and act on it.

With every action the sensor reads the previous one and the filter conditions the prior on the trace so far.
Then the policy compares two expected times (``mjx_fit.control.search``): of the search that goes on about its
centre c, and of one begun anew about the mean μ, and does what takes less:

    π E[max(|h - c|² - ρ², 0)] / (v d) + P(|h - c| < ρ) (t₀ + T),   T = t₀ + |x - μ| / w + π tr Σ / (v d)

It leaves the hole once another promises more insertions per second (``mjx_fit.task.hole_choice``) than this
one does with the smaller of both times.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int, Key

from mjx_fit.config.schema import Config
from mjx_fit.control import hunt, search
from mjx_fit.control.open_loop import TILT_S, YAW_S
from mjx_fit.control.policies import Policy, PolicyInput, PolicyStart
from mjx_fit.control.search import Plate, Search
from mjx_fit.filters import chart, frame
from mjx_fit.filters.kalman import scale_tril
from mjx_fit.filters.outcome_model import half_normal
from mjx_fit.filters.updates import detected_belief
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.sensors.contact_sensor import ContactSensor
from mjx_fit.sensors.trained_sensor import TrainedSensor
from mjx_fit.task.attempt_readers import Past, Reader, reader_of
from mjx_fit.types import Array, Belief, pytree
from mjx_fit.utils.rates import ACTION_S

NAME = "seek"
GEOMETRIC = f"{NAME}_geometry"
SPELL_ACTIONS = 20
"""Actions of a spell that may be led astray."""
_SPELLS = 2**22
"""Offset of the keys of spells: beyond those of policies and of errors (``engines.policy_runner``)."""


@pytree
class Thought:
    """State of ``seek``.

    Attributes:
        past: What the reader keeps of the attempt so far; None without a reader.
        prior: Belief before the attempt.
        belief: Belief after the trace so far.
        search: The search.
        leaves: Whether the hole is to be left.
        turn: Orientation that the tool is to have, a rotation vector from that of the estimate, rad; None: no
            rotation is believed.
        places: Points of equal weight that stand for where the hole may be, m; None: the belief's Gaussian.
    """

    past: Past
    prior: Belief
    belief: Belief
    search: Search
    leaves: Bool[Array, ""]
    turn: Float[Array, "3"] | None = None
    places: Float[Array, "k 2"] | None = None


def seek(config: Config, sensor: ContactSensor | None = None, name: str = NAME) -> Policy:
    """Create the policy.

    Args:
        config: Defines pitch and speeds (section ``seek``), the filters, and the most actions of an attempt
            that are read: ``task.attempt_actions``.
        sensor: Sensor that reads attempts in progress. None: the geometry of the parts reads them if
            ``filter.reads`` asks for it; otherwise the belief stays the prior, and is not reported.
        name: Name in data sets and results.

    Raises:
        RequestError: The sensor cannot read an attempt in progress.
    """
    turns = frame.turns(config.filter.coordinates)
    reader = reader_of(config, sensor)

    def init(start: PolicyStart, key: Key[Array, ""]) -> Thought:
        prior = start.belief
        if prior is None:
            prior = detected_belief(start.estimate_world, config)
        past = None if reader is None else reader.begin(prior, start, key)
        prior = replace(prior, memory=None)  # that is the reader's
        begun, upright = search.begin(start.estimate_world), jnp.zeros(3) if turns else None
        places = None if reader is None or reader.places is None else reader.places(past)
        return Thought(past, prior, prior, begun, jnp.zeros((), bool), upright, places)

    return Policy(
        init,
        _act(reader, config),
        name,
        reads=reader is not None,
        report=None if reader is None else _belief,
        gives_up=lambda thought: thought.leaves,
        turns=turns,
    )


def _act(
    reader: Reader | None, config: Config
) -> Callable[[Thought, PolicyInput], tuple[Thought, Float[Array, "k"]]]:
    """Return the function that reads, decides and moves on."""

    def act(thought: Thought, seen: PolicyInput) -> tuple[Thought, Float[Array, "k"]]:
        if reader is not None:
            reads = (seen.step > 0) & (seen.step <= config.task.attempt_actions)
            read, kept = partial(_read, reader), lambda thought, seen: thought
            thought = jax.lax.cond(reads, read, kept, thought, seen)
            thought = decided_or_astray(thought, seen, config)
        now, command = search.step(
            thought.search, seen, config.seek, plate=plate_below(thought.belief, seen, config)
        )
        thought = replace(thought, search=now)
        if thought.turn is None:
            return thought, command
        turn = turned_to_belief(thought.turn, thought.belief, config)
        rocked = turn + rocking(seen.step, thought.belief, now.dropped, config) * now.touched
        return replace(thought, turn=turn), jnp.concatenate([command, rocked])

    return act


def _read(reader: Reader, thought: Thought, seen: PolicyInput) -> Thought:
    """Read the previous action and update the belief."""
    past, belief = reader.add(thought.past, thought.prior, seen)
    places = None if reader.places is None else reader.places(past)
    return replace(thought, past=past, belief=belief, places=places)


def seek_by_geometry(config: Config) -> Policy:
    """Return the policy whose belief comes from the geometry of contact."""
    return seek(config, None, GEOMETRIC)


def seek_with(sensor: TrainedSensor, config: Config) -> tuple[Config, Policy]:
    """Return the policy of a trained sensor, named after it, and the configuration with its network.

    Raises:
        RequestError: The sensor cannot read an attempt in progress, or does not suit the configuration.
    """
    config = sensor.adapt(config)
    return config, seek(config, sensor.network, f"{NAME}@{sensor.fingerprint[:12]}")


def plate_below(belief: Belief, seen: PolicyInput, config: Config) -> Plate | None:
    """Return the believed plate below the TCP; None: no height is believed."""
    names, top_m = config.filter.coordinates, plate_top_m(config.scene)
    if "z" not in names:
        return None
    here, z = seen.tip_pos_world, names.index("z")
    over = frame.frame_of(belief.mean_world, names).seen(here, top_m)[2] - top_m
    return Plate(here[2] - over, jnp.sqrt(belief.cov[z, z]))


def _belief(thought: Thought) -> Belief:
    return thought.belief


def turned_to_belief(turn: Float[Array, "3"], belief: Belief, config: Config) -> Float[Array, "3"]:
    """Return the tool's orientation, turned towards the believed one no faster than ``seek.turn_radps``."""
    wanted = frame.frame_of(belief.mean_world, config.filter.coordinates).rotation_world.log()
    away, most = wanted - turn, config.seek.turn_radps * ACTION_S
    return turn + away * jnp.minimum(1, most / jnp.maximum(jnp.linalg.norm(away), 1e-9))


def rocking(
    step: Int[Array, ""], belief: Belief, dropped: Bool[Array, ""], config: Config
) -> Float[Array, "3"]:
    """Return the rotation of the search in rotation at an action, a rotation vector, rad.

    Its phases are those of ``control.open_loop.spiral_turn``: yaw and tilt meet in all combinations. The rim
    of a peg that tilts all around feels where the plate ends: hence more tilt while the hole may be far.
    A peg that has dropped would jam.
    """
    names, spread = config.filter.coordinates, jnp.sqrt(jnp.diagonal(belief.cov))
    size = jnp.stack([spread[names.index(name)] if name in names else jnp.zeros(()) for name in chart.AXIS])
    own, doubt_m = config.seek, jnp.sqrt(jnp.trace(belief.pos_cov) / 2)
    probe = (1.0 - dropped) * jnp.minimum(own.probe_radpm * doubt_m, own.probe_most_rad)
    size = own.rock * size + probe * jnp.array([1.0, 1.0, 0.0])
    yaw, tilt = (2 * jnp.pi * ACTION_S * step / period for period in (YAW_S, TILT_S))
    return size * jnp.stack([jnp.cos(tilt), jnp.sin(tilt), jnp.sin(yaw)])


def decided_or_astray(thought: Thought, seen: PolicyInput, config: Config) -> Thought:
    """Decide, except in spells led astray: they begin about a drawn place, unless the peg is in a hole."""
    if not config.seek.astray_share:
        return decided(thought, seen, config)
    spell, since = jnp.divmod(seen.step, SPELL_ACTIONS)
    led, drawn = jax.random.split(jax.random.fold_in(seen.attempt_key, _SPELLS + spell))
    off = scale_tril(thought.prior.pos_cov) @ jax.random.truncated_normal(drawn, -2.0, 2.0, (2,))
    about = search.about(thought.search, thought.prior.pos_mean_world + off)
    begins = (since == 0) & ~thought.search.dropped
    led_away = jax.tree.map(partial(jnp.where, begins), about, thought.search)
    astray = jax.random.bernoulli(led, config.seek.astray_share)
    chosen = replace(thought, search=led_away), decided(thought, seen, config)
    return jax.tree.map(partial(jnp.where, astray), *chosen)


def decided(thought: Thought, seen: PolicyInput, config: Config) -> Thought:
    """Begin the search anew if that takes less time than to go on, and decide whether to leave the hole."""
    belief, now = thought.belief, thought.search
    centre, anew, goes_on = _compared(thought, seen.tip_pos_world[:2], config)
    changes = now.touched & ~now.dropped & (anew < goes_on)
    about = search.about(now, centre)
    now = jax.tree.map(lambda new, old: jnp.where(changes, new, old), about, now)
    leaves = thought.leaves
    if seen.start.elsewhere_per_s is not None:
        match = jnp.exp(belief.type_logp[seen.start.peg_type])
        here = match / search.insertion_s(jnp.minimum(anew, goes_on), config.seek)
        leaves = (here < seen.start.elsewhere_per_s) & now.touched & ~now.dropped
    return replace(thought, search=now, leaves=leaves)


def _compared(
    thought: Thought, here_world: Float[Array, "2"], config: Config
) -> tuple[Float[Array, "2"], Float[Array, ""], Float[Array, ""]]:
    """Return the centre of a new search, and the expected times of it and of the one that goes on, s."""
    belief, own = thought.belief, config.seek
    if thought.places is not None:
        goes_on = hunt.remaining_s(thought.search, thought.places, own)
        return *hunt.best_new(here_world, thought.places, own), goes_on
    offsets = half_normal() @ scale_tril(belief.pos_cov).T
    holes = belief.pos_mean_world + jnp.concatenate([offsets, -offsets])
    anew = search.new_s(here_world, belief.pos_mean_world, belief.pos_cov, own)
    return belief.pos_mean_world, anew, search.remaining_s(thought.search, holes, anew, own)
