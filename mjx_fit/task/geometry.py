"""Beliefs from the geometry of contact: those after whole attempts, and those of an attempt in progress.

The particle filter (``mjx_fit.filters.particles``) works in the frame of one estimate: that of the attempt,
or, where earlier attempts are remembered, the one before all of them.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_batching import sequential_vmap
from jaxtyping import Bool, Float, Int, Key

from mjx_fit.config.schema import Config
from mjx_fit.filters import contact_memory, frame, particles
from mjx_fit.filters.particle_prior import Prior, prior_of
from mjx_fit.sensors.contact_rows import every, no_rows, rows_of, with_world_poses
from mjx_fit.sensors.reading import Window, read_window
from mjx_fit.types import Array, Belief, Felt, Memory, Particles, Reading, Rows, pytree


def geometry_update(config: Config, seen_as: Config) -> Callable[[Belief, Felt, Key[Array, "n"]], Belief]:
    """Return the function that conditions beliefs (n,) on the contact of attempts, one after the other.

    Beliefs that remember earlier attempts know them by their particles, and remember this one as well.

    Args:
        config: Defines the filter, the parts, and the errors of measurements that it reckons with.
        seen_as: Defines the errors that are added to the measurements, which the keys seed.
    """
    names, posed = config.filter.coordinates, with_world_poses(seen_as)

    def one(belief: Belief, felt: Felt, key: Key[Array, ""]) -> Belief:
        of_noise, of_draw, of_moves, of_rest = jax.random.split(key, 4)
        reading = read_window(felt, of_noise, posed, Window(felt.trace.action_world.shape[0]))
        rows, memory = every(rows_of(reading, config), config), _rows_kept(belief, config)
        before = belief if memory is None else memory.before
        origin = felt.estimate_world if memory is None else before.mean_world
        rows = contact_memory.seen_from(rows, felt.estimate_world, origin, names)
        prior = _prior(before, origin, felt.peg_type, config)
        begun = _begun(memory, rows, particles.drawn(prior, of_draw, config), config)
        found = particles.conditioned(begun.particles, prior, begun.rows, begun.known, of_moves, config)
        found = particles.settled(found, prior, begun.rows, of_rest, config)
        kept = belief.memory if memory is None else contact_memory.with_attempt(memory, rows, found, config)
        return replace(_belief(found, prior, origin, config), memory=kept)

    def learnt(beliefs: Belief, felt: Felt, keys: Key[Array, "n"]) -> Belief:
        return jax.lax.map(lambda each: one(*each), jax.tree.map(jnp.asarray, (beliefs, felt, keys)))

    return learnt


class _Begun(NamedTuple):
    """Particles before an attempt's rows, all rows, and how many of them the particles know."""

    particles: Particles
    rows: Rows
    known: int


def _rows_kept(belief: Belief, config: Config) -> Memory | None:
    """Return a belief's memory if it holds rows."""
    return belief.memory if config.particles.remember else None


def _begun(memory: Memory | None, rows: Rows, drawn: Particles, config: Config) -> _Begun:
    """Return what an attempt begins with: particles that know the remembered rows, or drawn ones."""
    # Particles drawn anew would have to find what several attempts tell at once, and few of them do.
    if memory is None:
        return _Begun(drawn, rows, 0)
    known, rows = len(memory.rows.weight), contact_memory.joined(memory.rows, rows)
    return _Begun(contact_memory.resumed(memory, drawn, config), rows, known)


@pytree
class Contact:
    """What is known of an attempt in progress.

    Attributes:
        particles: Particles after the rows that they know.
        prior: Belief that particles are in units of, about its estimate, the origin.
        origin: Frame of the rows.
        estimate: Frame of the readings.
        rows: Rows that are remembered, then those of the attempt so far; those to come have weight 0.
        known: Number of rows that the particles know.
    """

    particles: Particles
    prior: Prior
    origin: Float[Array, "D"]
    estimate: Float[Array, "D"]
    rows: Rows
    known: Int[Array, ""]


def begin(
    belief: Belief, estimate: Float[Array, "D"], peg_type: Int[Array, ""], key: Key[Array, ""], config: Config
) -> Contact:
    """Return what is known before an attempt.

    Args:
        belief: Belief in the frame of the estimate.
        estimate: The estimate in its own frame.
        peg_type: Type of the peg.
        key: Random key.
        config: Defines the filter and the most actions of an attempt that are read.
    """
    memory, rows = _rows_kept(belief, config), no_rows(config.task.attempt_actions // config.particles.every)
    before = belief if memory is None else memory.before
    origin = estimate if memory is None else before.mean_world
    prior = _prior(before, origin, peg_type, config)
    begun = _begun(memory, rows, particles.drawn(prior, key, config), config)
    known = jnp.asarray(begun.known, jnp.int32)
    return Contact(begun.particles, prior, origin, estimate, begun.rows, known)


def add(
    contact: Contact,
    reading: Reading,
    step: Int[Array, ""],
    running: Bool[Array, ""] | bool,
    key: Key[Array, ""],
    config: Config,
) -> Contact:
    """Add an action, and condition the particles on the rows that they do not know when it is time.

    Args:
        contact: What is known before.
        reading: Reading of the action, one row, in the frame of the estimate.
        step: Index of the action.
        running: Whether it counts; if not, no particle is moved.
        key: Random key of the attempt.
        config: Defines the filter.
    """
    own, names = config.particles, config.filter.coordinates
    row = contact_memory.seen_from(rows_of(reading, config), contact.estimate, contact.origin, names)
    own_rows = config.task.attempt_actions // own.every
    first, at = len(contact.rows.press) - own_rows, step // own.every
    counts = (step % own.every == own.every - 1) & (at < own_rows)
    at = first + at
    rows = jax.tree.map(lambda old, new: jnp.where(counts, old.at[at].set(new[0]), old), contact.rows, row)
    due = running & ((step + 1) % own.think_every == 0)
    contact, think = replace(contact, rows=rows), _thinking(config)
    now, upto = jax.random.fold_in(key, step), (at + counts).astype(jnp.int32)

    def once(state):
        return think(state[0], upto, state[1], now), jnp.zeros((), bool)

    # A loop, not a condition: of worlds side by side, a condition computes both outcomes at every action.
    return jax.lax.while_loop(lambda state: state[1], once, (contact, due))[0]


def _thinking(config: Config) -> Callable[[Contact, Array, Array, Key[Array, ""]], Contact]:
    """Return the function that conditions particles on all rows; of worlds where it is due, in turn."""

    def learnt(contact: Contact, upto: Array, key: Key[Array, ""]) -> Contact:
        found = particles.conditioned(
            contact.particles, contact.prior, contact.rows, contact.known, key, config
        )
        return replace(contact, particles=found, known=upto)

    @sequential_vmap
    def think(contact: Contact, upto: Array, due: Array, key: Key[Array, ""]) -> Contact:
        return jax.lax.cond(due, learnt, lambda contact, *_: contact, contact, upto, key)

    return think


def belief_of(contact: Contact, config: Config) -> Belief:
    """Return the belief of an attempt in progress, in the frame of its estimate."""
    return _belief(contact.particles, contact.prior, contact.origin, config)


def places_of(contact: Contact, config: Config) -> Float[Array, "N 2"]:
    """Return where the particles have the hole, x and y in the frame of the estimate, m."""
    steps, names = particles.steps_of(contact.particles, contact.prior), config.filter.coordinates
    origin = jnp.broadcast_to(contact.origin, steps.shape)
    steps = (frame.basis_of(frame.frame_of(origin, names), names) * steps[:, None, :]).sum(-1)
    return (contact.origin + steps)[:, :2]


def _prior(belief: Belief, origin: Float[Array, "D"], peg_type: Int[Array, ""], config: Config) -> Prior:
    """Return the prior about an origin."""
    first = None if belief.memory is None else _about(belief.memory.before, origin, config)
    return prior_of(_about(belief, origin, config), first, peg_type, config)


def _about(belief: Belief, origin: Float[Array, "D"], config: Config) -> Belief:
    """Return a belief as steps from an origin."""
    seen = frame.belief_in_frame(replace(belief, memory=None), origin, config.filter.coordinates)
    return replace(seen, mean_world=seen.mean_world - frame.upright(origin))


def _belief(found: Particles, prior: Prior, origin: Float[Array, "D"], config: Config) -> Belief:
    learnt = particles.summarised(found, prior, config)
    learnt = replace(learnt, mean_world=learnt.mean_world + frame.upright(origin))
    return frame.belief_in_world(learnt, origin, config.filter.coordinates)
