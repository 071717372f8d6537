"""What to do while an attempt lasts: go on, search elsewhere, try another hole, or stop.

The rules are those of the policy ``seek``: the time of a search that goes on about its centre against that
of one begun anew about the believed position (``mjx_fit.control.search``), and insertions per second here
against those that another hole promises, the way there included (``mjx_fit.task.hole_choice``).
"""

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mjx_fit.config.schema import Config
from mjx_fit.control import search
from mjx_fit.filters.frame import frame_of
from mjx_fit.filters.kalman import scale_tril
from mjx_fit.filters.outcome_model import half_normal
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.types import Array, Belief

LEAST_SAVED_S = 0.5
"""Expected time that a search elsewhere must save to be advised, s."""


@dataclass(frozen=True)
class Advice:
    """What to do.

    Attributes:
        what: ``go on``; ``recentre``: search about ``place_world``; ``next hole``: leave this one for
            ``hole``; ``stop``: the peg is in, or the force is too high.
        why: The reason, in words.
        place_world: Where to search, x and y, m.
        hole: Index of the hole to try.
    """

    what: Literal["go on", "recentre", "next hole", "stop"]
    why: str
    place_world: tuple[float, float] | None = None
    hole: int | None = None


class Searched(NamedTuple):
    """A search in contact so far.

    Attributes:
        centre_world: Where it began, or was told to begin anew, m.
        path_m: Length of its path in contact, m.
        here_world: Position of the TCP (3,), m.
        force_n: Force, tared.
    """

    centre_world: Float[np.ndarray, "2"]
    path_m: float
    here_world: Float[np.ndarray, "3"]
    force_n: float


class Elsewhere(NamedTuple):
    """The best of the other holes.

    Attributes:
        hole: Its index.
        per_s: Insertions per second that a visit to it promises.
    """

    hole: int
    per_s: float


class Adviser:
    """Gives advice; all that it computes in JAX is compiled by its first call."""

    def __init__(self, config: Config, most_n: float):
        """Take limits and times from a configuration.

        Args:
            config: Sections ``seek`` and ``task``, and the height of the socket.
            most_n: Force beyond which to stop, N.
        """
        self._config, self._most_n = config, most_n
        self._depth_m = config.task.insertion_depth_m + config.task.sensed_margin_m
        self._expected = jax.jit(self._expectations)

    def advise(
        self, belief: Belief, searched: Searched, peg_type: int | None, elsewhere: Elsewhere | None
    ) -> Advice:
        """Say what to do.

        Args:
            belief: Belief about the hole while it is tried, without batch axes.
            searched: The search so far.
            peg_type: Index of the type of the peg in hand; None: unknown.
            elsewhere: The best of the other holes; None: there is none.
        """
        expected = self._expected(
            belief,
            np.asarray(searched.centre_world, np.float32),
            np.float32(searched.path_m),
            np.asarray(searched.here_world, np.float32),
        )
        going_on, anew, insertion_s, below_m = map(float, expected)
        if below_m > self._depth_m:
            return Advice("stop", f"the tool is {1000 * below_m:.1f} mm below the top: the peg is in")
        if searched.force_n > self._most_n:
            return Advice(
                "stop", f"a force of {searched.force_n:.1f} N: at most {self._most_n:g} N are allowed"
            )
        if elsewhere is not None and peg_type is not None and searched.path_m > 0:
            per_s = float(np.exp(belief.type_logp[peg_type])) / insertion_s
            if elsewhere.per_s > per_s:
                there, here = 60 * elsewhere.per_s, 60 * per_s
                why = f"{there:.1f} insertions per minute are expected there, {here:.1f} here"
                return Advice("next hole", why, hole=elsewhere.hole)
        if searched.path_m > 0 and anew < going_on - LEAST_SAVED_S:
            x, y = map(float, np.asarray(belief.pos_mean_world))
            return Advice("recentre", f"{anew:.1f} s instead of {going_on:.1f} s are expected", (x, y))
        return Advice("go on", f"{going_on:.1f} s more are expected")

    def _expectations(
        self,
        belief: Belief,
        centre: Float[Array, "2"],
        path_m: Float[Array, ""],
        here: Float[Array, "3"],
    ) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
        """Return expected times, s: of going on, a new search, an insertion by the better one; and a depth.

        The depth is how far the TCP is below the top of the socket, as it is believed, m.
        """
        top_m = plate_top_m(self._config.scene)
        believed = frame_of(belief.mean_world, self._config.filter.coordinates)
        below_m = top_m - believed.seen(here, top_m)[2]
        own, mean, cov = self._config.seek, belief.pos_mean_world, belief.pos_cov
        offsets = half_normal() @ scale_tril(cov).T
        holes = mean + jnp.concatenate([offsets, -offsets])
        anew = search.new_s(here[:2], mean, cov, own)
        so_far = replace(search.begin(centre), path_m=path_m)
        going_on = search.remaining_s(so_far, holes, anew, own)
        return going_on, anew, search.insertion_s(jnp.minimum(going_on, anew), own), below_m
