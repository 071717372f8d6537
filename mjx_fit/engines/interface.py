"""The interface that every engine has."""

from typing import Protocol

import numpy as np
from jaxtyping import Bool

from mjx_fit.types import Attempt, Rollout


class Engine(Protocol):
    """Runs a batch of attempts: the same trace from the same scene, control and policies in both engines.

    Attributes:
        name: ``mjx`` or ``native``.
    """

    name: str

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
