"""The interface that every engine has."""

from typing import Protocol

import numpy as np
from jaxtyping import Bool

from mjx_fit.types import Attempt, Rollout
from mjx_fit.utils.errors import RequestError


class Engine(Protocol):
    """Runs a batch of attempts: the same trace from the same scene, control and policies in both engines.

    Attributes:
        name: ``mjx`` or ``native``.
        policy_name: Name of its own policy; None: it follows the policy that each attempt names.
    """

    name: str

    @property
    def policy_name(self) -> str | None: ...

    def run(
        self,
        attempts: Attempt,
        actions: int | None = None,
        active: Bool[np.ndarray, "n"] | None = None,
        horizon: int | None = None,
    ) -> Rollout:
        """Runs every attempt until its peg is inserted or its actions are used up.

        Args:
            attempts: A batch (n,) of attempts. MJX compiles once for each n.
            actions: J, the most actions in one attempt. None: ``task.attempt_actions``.
            active: Which of them to run; of the others nothing comes back but zeros. None: all.
            horizon: Actions that a policy is given to plan for, such as the length of a spiral; J or more.
                None: J.

        Returns:
            A batch (n,) of interactions with J rows each, as NumPy arrays.

        Raises:
            RequestError: The batch cannot be run (``mjx_fit.engines.requests``).
        """
        ...


def stored_policy_name(engine: Engine) -> str | None:
    """The name of the engine's own policy, as data sets and results store it; None where it has none.

    Raises:
        RequestError: The policy has no name.
    """
    if engine.policy_name == "":
        raise RequestError("engine: its policy has no name: give it one, as in Policy(init, act, 'probe')")
    return engine.policy_name
