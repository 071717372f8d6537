"""Where a peg that comes back to a hole starts (``task.revisit_from``), for R rows of any shape."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Key

from mjx_fit.config.schema import Config
from mjx_fit.filters import frame, search_map
from mjx_fit.filters.search_map import SearchMap
from mjx_fit.sensors.reading import Window, read_window
from mjx_fit.task.after_attempts import last_report
from mjx_fit.task.attempt_loop import Tried, placed_as
from mjx_fit.types import Array, Belief, Felt
from mjx_fit.utils.rates import ACTION_S

_AT_ONCE = 16
"""Maps that are updated together: each compares all cells with all points of its path."""


class Revisits:
    """Starts of later visits; with ``map``, maps of what was searched in vain.

    Args:
        detected: Beliefs about the holes before any visit, (*b).
        config: Defines the start, the capture, and what a visit covers.
    """

    def __init__(self, detected: Belief, config: Config):
        self._kind, self._config, seek = config.task.revisit_from, config, config.seek
        seconds = config.task.attempt_actions * ACTION_S
        # A second visit need not cover what a whole one could: its search begins in the middle.
        self._reach_m = 0.5 * float(np.sqrt(seconds * seek.speed_mps * seek.pitch_m / np.pi))
        self._shape = np.shape(detected.type_logp)[:-1]
        self._missed = np.zeros(self._shape, bool)
        self._maps: SearchMap | None = None
        if self._kind == "map":
            flat = _flat(detected)
            self._begun = jax.tree.map(np.asarray, _begun(flat.pos_mean_world, flat.pos_cov))
            self._maps = jax.tree.map(np.copy, self._begun)

    @property
    def forgets(self) -> bool:
        """Whether the position that was learnt is not where the next visit starts."""
        return self._kind != "belief"

    def started(self, beliefs: Belief, detected: Belief, where: Bool[np.ndarray, "*b"]) -> Belief:
        """Return beliefs with which the next visits start; ``where`` a hole is visited again."""
        if not self.forgets:
            return beliefs
        if self._maps is not None and self._missed.any():
            place = np.asarray(_best(self._maps, self._reach_m)).reshape(*self._shape, 2)
            mean = np.array(detected.mean_world)
            mean[..., :2] = np.where(self._missed[..., None], place, mean[..., :2])
            detected = replace(detected, mean_world=mean)
        return placed_as(beliefs, detected, where)

    def note(
        self,
        where: tuple[np.ndarray, ...],
        failed: Bool[np.ndarray, "n"],
        tried: Tried,
    ) -> None:
        """Note the visits of a round (n,) that failed.

        Args:
            where: Indices of their rows, one array (n,) for each axis of the rows.
            failed: Whether each visit was made and ended without an insertion.
            tried: The round. The noise of what it measured is that with which it was read.
        """
        (lost,), keys = np.nonzero(failed), tried.asked.noise_keys
        if self._maps is None or keys is None or not len(lost):
            return
        where = tuple(one[lost] for one in where)
        rows, k = np.ravel_multi_index(where, self._shape), len(lost)
        # A power of two: few shapes are compiled.
        padded = np.minimum(np.arange(1 << (k - 1).bit_length()), k - 1)
        before, felt = jax.tree.map(lambda leaf: leaf[rows[padded]], self._maps), tried.rollouts.felt
        padded = lost[padded]
        beliefs = _taken((tried.asked.beliefs, _learnt(tried)), padded)
        after = _after(before, beliefs, (felt[padded], keys[padded]), self._config)
        logp = np.array(self._maps.logp)
        logp[rows] = np.asarray(after.logp)[:k]
        self._maps = replace(self._maps, logp=logp)
        self._missed[where] = True

    def forget(self, rows: np.ndarray) -> None:
        """Begin anew in these rows of the first axis: another peg is in hand."""
        self._missed[rows] = False
        if self._maps is not None:
            logp = np.array(self._maps.logp).reshape(*self._shape, *self._maps.logp.shape[1:])
            logp[rows] = np.reshape(self._begun.logp, logp.shape)[rows]
            self._maps = replace(self._maps, logp=logp.reshape(self._maps.logp.shape))


def _flat(beliefs: Belief) -> Belief:
    axes = np.ndim(beliefs.type_logp) - 1
    return jax.tree.map(lambda leaf: jnp.asarray(leaf).reshape(-1, *np.shape(leaf)[axes:]), beliefs)


@jax.jit
def _begun(mean_world: Float[Array, "n 2"], cov: Float[Array, "n 2 2"]) -> SearchMap:
    return jax.vmap(search_map.begun)(mean_world, cov)


@partial(jax.jit, static_argnums=1)
def _best(maps: SearchMap, reach_m: float) -> Float[Array, "n 2"]:
    return jax.lax.map(partial(search_map.best_place, reach_m=reach_m), maps, batch_size=_AT_ONCE)


def _learnt(tried: Tried) -> Belief:
    """Return the beliefs at the ends of the attempts, also of those that refuted them."""
    if isinstance(tried.rollouts.report, Belief):
        return last_report(tried.rollouts)
    return tried.beliefs


def _taken(beliefs: tuple[Belief, Belief], rows: np.ndarray) -> tuple[Belief, Belief]:
    return jax.tree.map(lambda leaf: np.asarray(leaf)[rows], beliefs)


@partial(jax.jit, static_argnums=3)
def _after(
    maps: SearchMap, beliefs: tuple[Belief, Belief], read: tuple[Felt, Key[Array, "n"]], config: Config
) -> SearchMap:
    """Return the maps after visits in vain, given the beliefs before and at the end of each."""
    window = Window(read[0].trace.action_world.shape[1])

    def one(of):
        before, (prior, posterior), (own, key) = of
        reading = read_window(own, key, config, window)
        path = reading.tip_pos_estimate[:, :2]
        if not frame.is_world(config.filter.coordinates):
            here = frame.frame_of(own.estimate_world, config.filter.coordinates).rotation_world
            path = (here.as_matrix() @ reading.tip_pos_estimate.T).T[:, :2]
        path = path + own.estimate_world[:2]
        felt = search_map.felt(before, prior, posterior, config.filter)
        return search_map.missed(felt, path, reading.contact > 0, config.filter)

    return jax.lax.map(one, (maps, beliefs, read), batch_size=_AT_ONCE)
