"""Policies in the frame of the estimate: they see the socket upright, and their commands are turned back.

A policy written for upright sockets so serves any estimated pose (``mjx_fit.filters.frame``).
"""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
from jaxlie import SO3
from jaxtyping import Bool, Float, Key

from mjx_fit.config.schema import Config
from mjx_fit.control.levelling import levelled
from mjx_fit.control.open_loop import shipped
from mjx_fit.control.policies import Policy, PolicyInput, PolicyStart, State
from mjx_fit.control.regulation import regulated
from mjx_fit.filters import frame
from mjx_fit.filters.frame import Frame
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.types import Array, Belief, pytree


@pytree
class Framed:
    """State of a policy in a frame.

    Attributes:
        state: State of the policy.
        estimate_world: Estimate that defines the frame, m and rad.
    """

    state: State
    estimate_world: Float[Array, "D"]


def acting(policy: Policy | None, config: Config) -> Policy:
    """Return a policy as engines run it: in the frame of the estimate, levelled and regulated.

    Args:
        policy: Custom policy; None: the policy that each attempt names.
        config: Configuration of the engine.
    """
    return regulated(framed(levelled(policy or shipped(config), config), config), config.control)


def framed(policy: Policy, config: Config) -> Policy:
    """Return the policy as it acts in the frame of each attempt's estimate.

    Args:
        policy: Policy for upright sockets.
        config: Defines the coordinates of estimates. With x and y alone the policy stays as it is.
    """
    coordinates, top_m = config.filter.coordinates, plate_top_m(config.scene)
    if frame.is_world(coordinates):
        return policy
    turns = policy.turns or frame.turns(coordinates)

    def init(start: PolicyStart, key: Key[Array, ""]) -> Framed:
        estimate = jnp.asarray(start.estimate_world)
        return Framed(policy.init(_start_seen(start, coordinates), key), estimate)

    def act(state: Framed, seen: PolicyInput) -> tuple[Framed, Float[Array, "k"]]:
        here = frame.frame_of(seen.start.estimate_world, coordinates)
        inner, command = policy.act(state.state, _seen(seen, here, coordinates, top_m))
        return replace(state, state=inner), _command_in_world(command, here, turns=turns)

    def report(state: Framed) -> Any:
        assert policy.report is not None
        told = policy.report(state.state)
        if isinstance(told, Belief):
            return frame.belief_in_world(told, state.estimate_world, coordinates)
        return told

    def gives_up(state: Framed) -> Bool[Array, ""]:
        assert policy.gives_up is not None
        return policy.gives_up(state.state)

    return policy._replace(
        init=init,
        act=act,
        report=policy.report and report,
        gives_up=policy.gives_up and gives_up,
        turns=turns,
    )


def as_seen(seen: PolicyInput, config: Config) -> PolicyInput:
    """Return what a policy sees, in the frame of the attempt's estimate."""
    coordinates = config.filter.coordinates
    if frame.is_world(coordinates):
        return seen
    here = frame.frame_of(seen.start.estimate_world, coordinates)
    return _seen(seen, here, coordinates, plate_top_m(config.scene))


def _start_seen(start: PolicyStart, coordinates: tuple[str, ...]) -> PolicyStart:
    belief = start.belief
    if belief is not None:
        belief = frame.belief_in_frame(belief, start.estimate_world, coordinates)
    return replace(start, estimate_world=jnp.asarray(start.estimate_world)[:2], belief=belief)


def _seen(seen: PolicyInput, here: Frame, coordinates: tuple[str, ...], top_m: float) -> PolicyInput:
    back = here.rotation_world.inverse()
    return replace(
        seen,
        start=_start_seen(seen.start, coordinates),
        tip_pos_world=here.seen(seen.tip_pos_world, top_m),
        tip_quat_world=(back @ SO3(jnp.asarray(seen.tip_quat_world))).wxyz,
        tip_linvel_world=back @ seen.tip_linvel_world,
        tip_angvel_world=back @ seen.tip_angvel_world,
    )


def _command_in_world(command: Float[Array, "k"], here: Frame, *, turns: bool) -> Float[Array, "K"]:
    """Return the command in the world: displacement, and the orientation that it is to have in the frame."""
    displacement = here.rotation_world @ command[:3]
    if not turns:
        return displacement
    own = SO3.exp(command[3:]) if command.shape[0] > 3 else SO3.identity()
    return jnp.concatenate([displacement, (here.rotation_world @ own).log()])
