"""Worlds that a caller steps action by action, in either engine: what both have in common.

As a policy does, the caller acts in the frame of the attempt's estimate (``mjx_fit.control.framed``).
"""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
from jaxtyping import Float

from mjx_fit.config.schema import Config
from mjx_fit.control.framed import acting
from mjx_fit.control.policies import Policy
from mjx_fit.engines.attempt_rules import Tip, Verdict
from mjx_fit.engines.policy_runner import Memory
from mjx_fit.filters import frame
from mjx_fit.types import Array, Trace, pytree


def from_outside(config: Config) -> Policy:
    """Return the policy whose innermost state is its next command, which the caller writes there.

    A command has three components, m, or six where a rotation is believed, m and rad.
    """
    turns = frame.turns(config.filter.coordinates)
    still = jnp.zeros(6 if turns else 3)
    policy = Policy(lambda start, key: still, lambda command, seen: (command, command), turns=turns)
    return acting(policy, config)


@pytree
class Stepped:
    """Worlds (n,) after one action.

    Attributes:
        row: Row of the trace of each, as engines record it.
        peg: Pegs as they are judged (``attempt_rules.peg_of``).
        verdict: Whether each is inserted or broken, by the truth; the caller has to restart these.
        tare_sensor: Clean readings of the F/T sensors in free space, N and N·m.
    """

    row: Trace
    peg: Tip
    verdict: Verdict
    tare_sensor: Float[Array, "*n 6"]

    @property
    def wrench_sensor(self) -> Float[Array, "*n 50 6"]:
        """Wrenches of the action, tared and without errors, N and N·m."""
        return self.row.wrench_sensor - self.tare_sensor[..., None, :]


def told(memory: Memory, command: Float[Array, "*n k"]) -> Memory:
    """Return the memory of ``from_outside`` with this command as the next."""
    return replace(memory, state=_with_innermost(memory.state, command))


def _with_innermost(state: Any, command: Float[Array, "*n k"]) -> Any:
    """Replace the state of the policy that others wrap."""
    inner = getattr(state, "state", None)
    return command if inner is None else replace(state, state=_with_innermost(inner, command))
