"""Interface of the physics engines."""

from typing import Protocol

import numpy as np
from jaxtyping import Bool

from mjx_fit.types import Attempt, Rollout
from mjx_fit.utils.errors import RequestError


class Engine(Protocol):
    """Physics engine that runs batches of attempts; both engines share the scene, control and policies.

    Attributes:
        name: Name of the engine, ``mjx`` or ``native``.
        policy_name: Name of its custom policy; None: it follows the policy that each attempt names.
        turns: Whether commands have six components: displacement and orientation of the TCP.
    """

    name: str
    turns: bool

    @property
    def policy_name(self) -> str | None: ...

    def run(
        self,
        attempts: Attempt,
        actions: int | None = None,
        active: Bool[np.ndarray, "n"] | None = None,
        horizon: int | None = None,
    ) -> Rollout:
        """Run every attempt until its peg is inserted or its actions are used up.

        Args:
            attempts: Batch (n,) of attempts. MJX compiles once for each n.
            actions: Maximum number of actions in one attempt, J. None: ``task.attempt_actions``.
            active: Whether to run each attempt; the rollouts of the others are zero. None: all.
            horizon: Number of actions that a policy plans for, such as the length of a spiral; J or more.
                None: J.

        Returns:
            Batch (n,) of rollouts with J rows each, as NumPy arrays.

        Raises:
            RequestError: The batch is invalid (``mjx_fit.engines.requests``).
        """
        ...


def stored_policy_name(engine: Engine) -> str | None:
    """Return the name of the custom policy, as data sets and results store it; None without one.

    Raises:
        RequestError: The policy has no name.
    """
    if engine.policy_name == "":
        raise RequestError("engine: its custom policy has no name: name it, as in Policy(init, act, 'probe')")
    return engine.policy_name
