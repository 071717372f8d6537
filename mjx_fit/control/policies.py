"""Low-level policies: pure functions that command a displacement of the TCP for each action.

A policy is a pair of JAX functions, ``Policy(init, act)``, which both engines compile into their rollouts.
It carries its own state from action to action and observes only what a robot can measure. Randomness of
action j comes from ``fold_in(key, j)``, so it depends on the attempt alone.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool, Float, Int, Key

from mjx_fit.types import Array, Attempt, Belief, Reading
from mjx_fit.utils.pytrees import pytree, static

NAMES = ("spiral", "random")
SPIRAL, RANDOM = range(len(NAMES))
OWN = len(NAMES)
"""Index of a custom policy, which is not among ``NAMES``."""

State = Any
"""State of a policy: a pytree of arrays whose shapes and dtypes do not change between actions."""


@pytree
class PolicyStart:
    """Information available to a policy before its first action.

    Attributes:
        peg_type: Index of the peg's shape.
        estimate_world: Estimate p of the hole's centre, above which the attempt starts, m. A policy sees the
            world in the frame of the estimate (``mjx_fit.control.framed``), in which the socket is upright.
        policy: The attempt's index into ``NAMES``, for policies that switch on it.
        belief: As in ``Attempt``.
        elsewhere_per_s: As in ``Attempt``.
    """

    peg_type: Int[Array, ""]
    estimate_world: Float[Array, "2"]
    policy: Int[Array, ""]
    belief: Belief | None = None
    elsewhere_per_s: Float[Array, ""] | None = None


@pytree
class PolicyInput:
    """Input of a policy for each action: measurements, time, and the initial information.

    Example:
        >>> import jax.numpy as jnp, mjx_fit as mf
        >>> def towards_estimate(seen: mf.PolicyInput):
        ...     return jnp.append(seen.start.estimate_world - seen.tip_pos_world[:2], -0.004)
        >>> policy = mf.stateless_policy(towards_estimate)

    Attributes:
        start: Initial information, as passed to ``Policy.init``.
        attempt_key: Random key of the attempt, as passed to ``Policy.init``.
        key: Random key of this action: ``fold_in(attempt_key, step)``.
        step: Index j of the action, from 0; the time is j / 10 s.
        horizon: Number J of actions to plan for; a Python int, known when the policy is compiled.
        tip_pos_world: Position x of the tool centre point (TCP), m.
        tip_quat_world: Orientation of the TCP, w x y z.
        tip_linvel_world: Linear velocity of the TCP, m/s.
        tip_angvel_world: Angular velocity of the TCP, rad/s.
        wrench_sensor: Force (N) and torque (N·m) that the arm exerts on the peg, measured by the F/T sensor
            during the previous action: 500 Hz, tared, with sensor noise. Noise alone before the first action.
        contact: True if this wrench indicates contact (``mjx_fit.sensors.force_torque.in_contact``).
        reading: The previous action as the learned sensor reads it (``sensors.reading.read_action``), for
            policies that read; None for the others. Before the first action it is meaningless.
        running: Whether what the policy does counts. It does not after the end of an attempt, and in rows
            that fill up a batch: costly work can be left out there.
    """

    start: PolicyStart
    attempt_key: Key[Array, ""]
    key: Key[Array, ""]
    step: Int[Array, ""]
    tip_pos_world: Float[Array, "3"]
    tip_quat_world: Float[Array, "4"]
    tip_linvel_world: Float[Array, "3"]
    tip_angvel_world: Float[Array, "3"]
    wrench_sensor: Float[Array, "50 6"]
    contact: Bool[Array, ""]
    horizon: int = static()
    reading: Reading | None = None
    running: Bool[Array, ""] | bool = True


class Policy(NamedTuple):
    """Low-level policy for one attempt in one world.

    Example:
        Press down until the F/T sensor indicates contact, then stay:

        >>> import jax, jax.numpy as jnp, mjx_fit as mf
        >>> def act(touched, seen):
        ...     touched = touched | seen.contact
        ...     return touched, jnp.array([0.0, 0.0, -0.004]) * ~touched
        >>> probe = mf.Policy(init=lambda start, key: jnp.array(False), act=act)
        >>> engine = mf.make_engine("native", policy=probe)
        >>> rollouts = engine.run(mf.draw_attempts(jax.random.key(0), 2), actions=4)
        >>> (rollouts.felt.trace.action_world[:, :, 2] < 0).tolist()
        [[True, True, False, False], [True, True, False, False]]

    Attributes:
        init: Maps the initial information and the attempt's key to the state before the first action.
        act: Maps the state and the input to the state after the action and the command: the desired
            displacement of the TCP in the world frame (3,), m.
        name: Name in data sets and results, which refuse a policy without one.
        reads: Whether it needs ``PolicyInput.reading``.
        report: Maps the state after each action to a pytree of arrays that the engines record in
            ``Rollout.report``, such as a belief; None: nothing is recorded.
        gives_up: Maps the state after an action to whether the attempt ends with it; None: never.
        turns: Whether its commands have six components: the last three are the orientation that the TCP is to
            have at the end of the action, the rotation vector from straight down, about the world's axes,
            rad. Others keep the TCP straight down.
    """

    init: Callable[[PolicyStart, Key[Array, ""]], State]
    act: Callable[[State, PolicyInput], tuple[State, Float[Array, "k"]]]
    name: str = ""
    reads: bool = False
    report: Callable[[State], Any] | None = None
    gives_up: Callable[[State], Bool[Array, ""]] | None = None
    turns: bool = False

    @property
    def width(self) -> int:
        """Number of components of a command."""
        return 6 if self.turns else 3


def start_of(attempt: Attempt) -> PolicyStart:
    """Return the part of an attempt that a policy may use: nothing about the true hole."""
    return PolicyStart(
        attempt.peg_type, attempt.estimate_world, attempt.policy, attempt.belief, attempt.elsewhere_per_s
    )


def hooks_of_inner(policy: Policy) -> dict[str, Callable[[State], Any] | None]:
    """Return ``report`` and ``gives_up`` for a policy around this one, which keeps its state as ``state``."""

    def of_inner(function: Callable[[State], Any]) -> Callable[[State], Any]:
        return lambda outer: function(outer.state)

    named = {"report": policy.report, "gives_up": policy.gives_up}
    return {name: None if function is None else of_inner(function) for name, function in named.items()}


def by_name(*members: Policy) -> Policy:
    """Combine policies into one that acts as the member with index ``PolicyStart.policy``.

    If one of them turns the TCP, the others hold it straight down.
    """
    turns = any(member.turns for member in members)

    def init(start: PolicyStart, key: Key[Array, ""]) -> State:
        return tuple(member.init(start, key) for member in members)

    def act(state: State, seen: PolicyInput) -> tuple[State, Float[Array, "k"]]:
        acted = [member.act(own, seen) for member, own in zip(members, state, strict=True)]
        commands = [jnp.pad(command, (0, 6 - len(command))) if turns else command for _, command in acted]
        command = commands[-1]
        for i in reversed(range(len(members) - 1)):
            command = jnp.where(seen.start.policy == i, commands[i], command)
        return tuple(own for own, _ in acted), command

    return Policy(init, act, turns=turns)


def stateless(
    command: Callable[[PolicyInput], Float[Array, "k"]], name: str = "", *, turns: bool = False
) -> Policy:
    """Create a stateless policy from a function of its input; ``turns`` as in ``Policy``.

    Example:
        >>> import jax.numpy as jnp, mjx_fit as mf
        >>> press = mf.stateless_policy(lambda seen: jnp.array([0.0, 0.0, -0.004]))
        >>> engine = mf.make_engine("native", policy=press)
    """
    return Policy(lambda start, key: (), lambda state, seen: ((), command(seen)), name, turns=turns)
