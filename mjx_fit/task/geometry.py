"""Beliefs from the geometry of contact: those after whole attempts, and those of an attempt in progress.

The particle filter (``mjx_fit.filters.particles``) works in the frame of an attempt's estimate.
"""

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
from jax.custom_batching import sequential_vmap
from jaxtyping import Bool, Float, Int, Key

from mjx_fit.config.schema import Config
from mjx_fit.filters import frame, particles
from mjx_fit.filters.contact_model import Rows
from mjx_fit.filters.particle_prior import Prior, prior_of
from mjx_fit.filters.particles import Particles
from mjx_fit.sensors.contact_rows import every, rows_of, with_world_poses
from mjx_fit.sensors.reading import Window, read_window
from mjx_fit.types import Array, Belief, Felt, Reading, pytree


def geometry_update(config: Config) -> Callable[[Belief, Felt, Key[Array, "n"]], Belief]:
    """Return the function that conditions beliefs (n,) on the contact of attempts, one after the other.

    Args:
        config: Defines the filter, the parts, and the noise of the measurements, which the keys seed.
    """
    names, posed = config.filter.coordinates, with_world_poses(config)

    def one(belief: Belief, felt: Felt, key: Key[Array, ""]) -> Belief:
        of_noise, of_draw, of_moves, of_rest = jax.random.split(key, 4)
        reading = read_window(felt, of_noise, posed, Window(felt.trace.action_world.shape[0]))
        rows = every(rows_of(reading, config), config)
        seen = frame.belief_in_frame(belief, felt.estimate_world, names)
        prior = _prior(seen, felt.estimate_world, felt.peg_type, config)
        found = particles.drawn(prior, of_draw, config)
        found = particles.conditioned(found, prior, rows, 0, of_moves, config)
        found = particles.settled(found, prior, rows, of_rest, config)
        learnt = _belief(found, prior, felt.estimate_world, config)
        return frame.belief_in_world(learnt, felt.estimate_world, names)

    def learnt(beliefs: Belief, felt: Felt, keys: Key[Array, "n"]) -> Belief:
        return jax.lax.map(lambda each: one(*each), jax.tree.map(jnp.asarray, (beliefs, felt, keys)))

    return learnt


@pytree
class Contact:
    """What is known of an attempt in progress.

    Attributes:
        particles: Particles after the rows that they know.
        prior: Belief before the attempt, about the estimate.
        rows: Rows so far; those to come have weight 0.
        known: Number of rows that the particles know.
    """

    particles: Particles
    prior: Prior
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
    prior = _prior(belief, estimate, peg_type, config)
    n = config.task.attempt_actions // config.particles.every
    rows = Rows(*(jnp.zeros((n, *shape)) for shape in ((3,), (3, 3), (), (2,), ())))
    return Contact(particles.drawn(prior, key, config), prior, rows, jnp.zeros((), jnp.int32))


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
    own = config.particles
    row, at = rows_of(reading, config), step // own.every
    counts = (step % own.every == own.every - 1) & (at < contact.rows.press.shape[0])
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


def belief_of(contact: Contact, estimate: Float[Array, "D"], config: Config) -> Belief:
    """Return the belief of an attempt in progress, in the frame of its estimate."""
    return _belief(contact.particles, contact.prior, estimate, config)


def _prior(belief: Belief, estimate: Float[Array, "D"], peg_type: Int[Array, ""], config: Config) -> Prior:
    """Return the prior about the estimate, of a belief in its frame."""
    about = replace(belief, mean_world=belief.mean_world - frame.upright(estimate))
    return prior_of(about, peg_type, config)


def _belief(found: Particles, prior: Prior, estimate: Float[Array, "D"], config: Config) -> Belief:
    learnt = particles.summarised(found, prior, config)
    return replace(learnt, mean_world=learnt.mean_world + frame.upright(estimate))
