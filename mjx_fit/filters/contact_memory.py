"""Memory of contact: what attempts at a hole leave behind that no Gaussian says.

Where a peg found no hole, there is none: after a few attempts the places that are left lie around those that
were searched. So rows of earlier attempts are kept, and a filter conditions what was believed before any of
them on all.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mjx_fit.config.schema import Config
from mjx_fit.filters import frame
from mjx_fit.filters.particle_prior import ERRORS, dimensions, errors_from
from mjx_fit.types import Array, Belief, Memory, Particles, Rows
from mjx_fit.utils.errors import RequestError


def remembering(belief: Belief, config: Config) -> Belief:
    """Return beliefs (*batch) with a memory of no attempt: what was believed before any is not forgotten."""
    own, batch = config.particles, belief.type_logp.shape[:-1]

    def none(*shape: int) -> Array:
        return jnp.zeros((*batch, *shape))

    n = own.remember * own.remember_rows
    attempt = jnp.broadcast_to(1 + jnp.arange(n) // own.remember_rows, (*batch, n)).astype(jnp.int32)
    rows = Rows(none(n, 3), none(n, 3, 3), none(n), none(n, 2), none(n), none(n), attempt)
    count = jnp.zeros(batch, jnp.int32)
    size = own.count if own.remember else 0
    found = Particles(none(size, dimensions(config)), jnp.zeros((*batch, size), jnp.int32))
    return replace(belief, memory=Memory(replace(belief, memory=None), rows, found, count))


def detected_as(beliefs: Belief, detected: Belief, config: Config) -> Belief:
    """Return beliefs (*batch) that know what was believed before any contact, and remember no attempt.

    Beliefs whose attempts would be remembered stay as they are: a memory of none would be all they know.
    """
    if config.filter.reads != "geometry" or config.particles.remember:
        return beliefs
    return replace(beliefs, memory=remembering(detected, config).memory)


def require_memory(beliefs: Belief, config: Config) -> None:
    """Check that what beliefs remember has the form that a configuration defines.

    Raises:
        RequestError: It has not; the message names the field.
    """
    if beliefs.memory is None:
        return
    wanted = jax.eval_shape(partial(remembering, config=config), replace(beliefs, memory=None)).memory
    paths = jax.tree_util.tree_flatten_with_path(wanted)[0]
    found = jax.tree_util.tree_leaves(beliefs.memory)
    if len(found) != len(paths):
        raise RequestError("belief: memory: a field is missing: use the memory that an attempt left")
    for (path, want), leaf in zip(paths, found, strict=True):
        kind = jnp.integer if jnp.issubdtype(want.dtype, jnp.integer) else jnp.floating
        if np.shape(leaf) != want.shape or not jnp.issubdtype(np.asarray(leaf).dtype, kind):
            name, shown = jax.tree_util.keystr(path), f"{np.asarray(leaf).dtype} {np.shape(leaf)}"
            expected = "integers" if kind is jnp.integer else "floats"
            raise RequestError(f"belief: memory{name}: {shown} is invalid: expected {expected} {want.shape}")


def resumed(memory: Memory, drawn: Particles, config: Config) -> Particles:
    """Return the particles that an attempt begins with: those after the last one, or drawn ones.

    The errors of an attempt's measurements are those of the attempt alone.
    """
    at = slice(errors_from(config), errors_from(config) + ERRORS)
    values = jnp.asarray(memory.particles.values).at[:, at].set(drawn.values[:, at])
    kept = replace(memory.particles, values=values)
    return jax.tree.map(lambda old, new: jnp.where(memory.count > 0, old, new), kept, drawn)


def with_attempt(memory: Memory, rows: Rows, found: Particles, config: Config) -> Memory:
    """Return a memory with one attempt more; the oldest one makes room for it.

    Args:
        memory: Memory before.
        rows: Rows of the attempt, in the frame of ``memory.before``.
        found: Particles after it.
        config: Defines how much is remembered.
    """
    own, first = config.particles, errors_from(config)
    kept = _kept(rows, jnp.exp(own.gap_spread * found.values[:, first + 1].mean()), config)
    full, at = memory.count >= own.remember, jnp.minimum(memory.count, own.remember - 1)

    def put(old: Array, new: Array, size: int) -> Array:
        old = jnp.where(full, jnp.roll(old, -size, 0), old)
        return jax.lax.dynamic_update_slice_in_dim(old, new, at * size, 0)

    rows = jax.tree.map(lambda old, new: put(old, new, own.remember_rows), memory.rows, kept)
    error, others = found.values[:, first : first + 1], found.values[:, first + ERRORS :]
    values = jnp.asarray(found.values).at[:, first + ERRORS :].set(put(others.T, error.T, 1).T)
    return replace(
        memory,
        rows=replace(rows, attempt=memory.rows.attempt),
        particles=replace(found, values=values),
        count=memory.count + 1,
    )


def _kept(rows: Rows, noise: Array, config: Config) -> Rows:
    """Return the rows of an attempt that are remembered, evenly spread over its contact."""
    own, size = config.particles, config.particles.remember_rows
    counts = (rows.weight > 0) & (rows.press > own.touch_n)
    rank, n = jnp.cumsum(counts), counts.sum()
    wanted = jnp.arange(size) * jnp.maximum(n, size) // size + 1
    which = jnp.minimum(jnp.searchsorted(rank, wanted), len(counts) - 1)
    kept = jax.tree.map(lambda leaf: leaf[which], rows)
    more = jnp.minimum(jnp.maximum(n, size) / size, 1 / own.row_weight)
    weight = jnp.where(wanted <= n, kept.weight * more, 0.0)
    return replace(kept, weight=weight, noise=jnp.broadcast_to(noise, size))


def joined(before: Rows, rows: Rows) -> Rows:
    """Return the remembered rows, then others."""
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), before, rows)


def seen_from(
    rows: Rows, estimate: Float[Array, "D"], origin: Float[Array, "D"], coordinates: tuple[str, ...]
) -> Rows:
    """Return rows in the frame of an estimate as they are in the frame of another one, the origin."""
    here, there = (frame.frame_of(place, coordinates) for place in (estimate, origin))
    apart = jnp.append(here.position_world - there.position_world, here.height_m - there.height_m)
    back = there.rotation_world.inverse()
    turn = back @ here.rotation_world
    tip = (turn.as_matrix() * rows.tip[..., None, :]).sum(-1) + back @ apart
    turned = (turn.as_matrix()[:, :, None] * rows.turn[..., None, :, :]).sum(-2)
    return replace(rows, tip=tip, turn=turned)
