"""Search about a centre in contact: an Archimedean spiral that can be begun anew elsewhere without a lift.

After a length s of the path, angle and radius are θ = √(4π s / d) and r = d θ / 2π with the pitch d, to first
order, and the searched disc has the area π r² = d s. So a search about c needs the time

    T(c) = π E|h - c|² / (v d)

on average to reach the hole h, at speed v. After radius ρ without success, it needs π E[max(|h - c|² - ρ²,
0)] / (v d) more for a hole that is still outside, while one inside has been missed and needs a new search.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from mjx_fit.config.sections.seek import SeekConfig
from mjx_fit.control.policies import Policy, PolicyInput
from mjx_fit.types import Array, pytree
from mjx_fit.utils.rates import ACTION_S

Path = Callable[[Float[Array, ""], float], Float[Array, "2"]]
"""Point of a search after a length of its path, m, given the pitch, m; relative to the centre, m."""
FOLLOW_M = 0.004
"""Largest lag of the TCP behind its goal with which the search goes on, m."""
REST_MPS = 0.003
"""Speed below which a peg in contact rests on something, m/s: noise alone may look like contact."""
SINK_MPS = 0.002
"""Speed of a peg that is going in, m/s: the search waits for it."""


@pytree
class Search:
    """State of a search.

    Attributes:
        centre_world: Centre of the spiral, m.
        path_m: Length s of the spiral so far, m.
        goal_world: Lateral goal of the TCP, m.
        touch_m: Height of the TCP when it first rested in contact, m; before, its height.
        touched: Whether it has rested in contact.
        dropped: Whether the peg had dropped at the last action.
    """

    centre_world: Float[Array, "2"]
    path_m: Float[Array, ""]
    goal_world: Float[Array, "2"]
    touch_m: Float[Array, ""]
    touched: Bool[Array, ""]
    dropped: Bool[Array, ""]

    def radius_m(self, config: SeekConfig) -> Float[Array, ""]:
        """Return the radius of the searched disc, m."""
        return jnp.sqrt(config.pitch_m * self.path_m / jnp.pi)


def begin(centre_world: Float[Array, "2"]) -> Search:
    """Return a search that has not begun."""
    zero, no = jnp.zeros(()), jnp.zeros((), bool)
    return Search(centre_world, zero, centre_world, zero, no, no)


def about(search: Search, centre_world: Float[Array, "2"]) -> Search:
    """Return the search begun anew about another centre."""
    return replace(search, centre_world=centre_world, path_m=jnp.zeros(()))


def spiral(path_m: Float[Array, ""], pitch_m: float) -> Float[Array, "2"]:
    """Return the point of the spiral after a length of its path, relative to its centre, m."""
    angle = jnp.sqrt(4 * jnp.pi * path_m / pitch_m)
    return pitch_m * angle / (2 * jnp.pi) * jnp.stack([jnp.cos(angle), jnp.sin(angle)])


def raster_search(config: SeekConfig) -> Policy:
    """Create the policy ``raster``: touch down and sweep the square about the estimate in parallel lines."""
    lines = partial(raster, half_width_m=config.raster_m)

    def act(search: Search, seen: PolicyInput) -> tuple[Search, Float[Array, "3"]]:
        return step(search, seen, config, lines)

    return Policy(lambda start, key: begin(start.estimate_world), act, "raster")


class Plate(NamedTuple):
    """The plate below the TCP, as believed.

    Attributes:
        height_m: Height.
        std_m: Its standard deviation.
    """

    height_m: Float[Array, ""]
    std_m: Float[Array, ""]


def step(
    search: Search,
    seen: PolicyInput,
    config: SeekConfig,
    path: Path = spiral,
    plate: Plate | None = None,
) -> tuple[Search, Float[Array, "3"]]:
    """Advance the search by one action along its path, by default the spiral, and return its command, m.

    A peg that has dropped by ``drop_m`` is at the hole: it is pushed more, rests while it sinks, and searches
    on a spiral about where it is if it does not. The goal waits for a TCP that is further behind than
    ``FOLLOW_M``, but not on a way back to it.

    Args:
        search: The search.
        seen: What the policy sees.
        config: Distances and speeds.
        path: The path.
        plate: The plate below the TCP, as believed. A drop is measured from there once its height is known
            to half of ``drop_m``; before, and without it, from the touch-down.
    """
    here, height = seen.tip_pos_world[:2], seen.tip_pos_world[2]
    rests = seen.contact & (jnp.abs(seen.tip_linvel_world[2]) < REST_MPS)
    touch = jnp.where(search.touched, search.touch_m, height)
    touched = search.touched | rests
    surface = touch
    if plate is not None:
        surface = jnp.where(plate.std_m < config.drop_m / 2, plate.height_m, touch)
    dropped = touched & (height < surface - config.drop_m)
    at_hole = replace(about(search, here), goal_world=here)
    search = jax.tree.map(partial(jnp.where, dropped & ~search.dropped), at_hole, search)
    search = replace(search, touch_m=touch, touched=touched, dropped=dropped)
    sinks = dropped & (seen.tip_linvel_world[2] < -SINK_MPS)

    def next_goal(path_m: Float[Array, ""]) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
        off = jnp.where(dropped, spiral(path_m, config.pitch_m), path(path_m, config.pitch_m))
        target = search.centre_world + off
        return target, towards(search.goal_world, target, config.slide_mps * ACTION_S)

    target, goal = next_goal(search.path_m)
    behind, ahead = (jnp.linalg.norm(place - here) for place in (search.goal_world, goal))
    arrived = jnp.linalg.norm(target - search.goal_world) < 1e-6
    moves = touched & ~sinks & ((behind < FOLLOW_M) | (ahead < behind))
    path_m = search.path_m + jnp.where(moves & arrived, config.speed_mps * ACTION_S, 0)
    goal = jnp.where(moves, next_goal(path_m)[1], search.goal_world)
    push = jnp.where(dropped, config.deep_push_m, jnp.where(touched, config.push_m, config.approach_push_m))
    return replace(search, path_m=path_m, goal_world=goal), jnp.append(goal - here, -push)


def raster(path_m: Float[Array, ""], pitch_m: float, half_width_m: float) -> Float[Array, "2"]:
    """Return the point of a raster after a length of its path, relative to the centre of its square, m.

    Lines a pitch apart, along x and back, joined at their ends; after the last one the path begins again.
    """
    width, lines = 2 * half_width_m, int(2 * half_width_m / pitch_m + 1e-6) + 1
    line, along = jnp.divmod(path_m % (lines * (width + pitch_m)), width + pitch_m)
    x = jnp.minimum(along, width) - half_width_m
    y = line * pitch_m + jnp.where(line < lines - 1, jnp.maximum(along - width, 0), 0) - half_width_m
    return jnp.stack([jnp.where(line % 2 == 0, x, -x), y])


def towards(from_world: Float[Array, "2"], to_world: Float[Array, "2"], most_m: float) -> Float[Array, "2"]:
    """Return the point on the way from one to the other, at most this far, m."""
    way = to_world - from_world
    return from_world + way * jnp.minimum(1, most_m / jnp.maximum(jnp.linalg.norm(way), 1e-9))


def time_s(area_m2: Float[Array, "*batch"], config: SeekConfig) -> Float[Array, "*batch"]:
    """Return the time of searching π times this area, s."""
    return jnp.pi * area_m2 / (config.speed_mps * config.pitch_m)


def visit_s(spread_m2: Float[Array, "*batch"], config: SeekConfig) -> Float[Array, "*batch"]:
    """Compute the expected time of a visit to a hole, s, given the trace of the belief's covariance, m²."""
    return insertion_s(time_s(spread_m2, config), config)


def insertion_s(blind_s: Float[Array, "*batch"], config: SeekConfig) -> Float[Array, "*batch"]:
    """Compute the expected time to an insertion, s, given that of a search that feels nothing.

    What finds the hole first counts, the search or the sense of touch: t f / (t + f) with the time f =
    ``feel_s``. The peg is then pushed in.
    """
    return config.sink_s + blind_s * config.feel_s / (blind_s + config.feel_s)


def remaining_s(
    search: Search, holes_world: Float[Array, "k 2"], new_s: Float[Array, ""], config: SeekConfig
) -> Float[Array, ""]:
    """Compute the expected time of a search that goes on, s: of holes outside, and of those missed inside.

    Args:
        search: The search.
        holes_world: Points of equal weight that stand for the belief about the hole, m.
        new_s: Expected time of a new search.
        config: Pitch and speed.
    """
    squared = jnp.square(holes_world - search.centre_world).sum(-1)
    left = squared - search.radius_m(config) ** 2
    return time_s(jnp.maximum(left, 0).mean(), config) + (left < 0).mean() * (config.change_s + new_s)


def new_s(
    here_world: Float[Array, "2"], mean_world: Float[Array, "2"], cov: Float[Array, "2 2"], config: SeekConfig
) -> Float[Array, ""]:
    """Compute the expected time of a search begun anew about the mean: change, slide and spiral, s."""
    way = jnp.linalg.norm(mean_world - here_world)
    return config.change_s + way / config.slide_mps + time_s(jnp.trace(cov), config)
