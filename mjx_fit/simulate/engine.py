"""What an engine is, and which one ``auto`` means."""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

import math
from typing import Protocol

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Bool, Float

from mjx_fit import granted
from mjx_fit.config import Config
from mjx_fit.errors import RequestError, shown
from mjx_fit.kinematics import Chain, inverse
from mjx_fit.scene import Scene
from mjx_fit.types import Array, Attempt, Interaction

ENGINES = ("auto", "mjx", "native")

START_HEIGHT_M = 0.002
"""Height of the tip over the plate at which an attempt starts, at rest."""


BESIDE_M, BELOW_M = 0.02, 0.002
"""Horizontal distance from the hole's centre, and distance below the hole's floor, beyond which a peg that is
low has left the plate instead: a quarter of the smallest plate's half width, more than any contact yields."""


class Engine(Protocol):
    """Runs a batch of attempts: the same trace from the same scene, control and policies in both."""

    name: str

    def run(
        self,
        attempts: Attempt,
        actions: int,
        active: Bool[np.ndarray, "n"] | None = None,
        horizon: int | None = None,
    ) -> Interaction:
        """Runs every attempt until its peg is inserted or its actions are used up.

        Args:
            attempts: A batch (n,) of attempts. MJX compiles once for each n.
            actions: J, the most actions in one attempt.
            active: Which of them to run; of the others nothing comes back but zeros. None: all.
            horizon: Actions that a policy is given to plan for, such as the length of a spiral; J or more.
                None: J.

        Returns:
            A batch (n,) of interactions with J rows each, as NumPy arrays.

        Raises:
            RequestError: The batch cannot be run (``mjx_fit.simulate.requests``).
        """
        ...


def is_inserted(
    tip_pos_world: Float[Array, "*n 3"], hole_pos_world: Float[Array, "*n 2"], scene: Scene, depth_m: float
) -> Bool[Array, "*n"]:
    """Whether pegs are in their holes: the tip so far below the plate's top, not under the hole, nor beside.

    Args:
        tip_pos_world: Centre of the peg's lower face, m.
        hole_pos_world: True centre of the hole, m.
        scene: Gives the height of the plate's top.
        depth_m: ``task.insertion_depth_m``.
    """
    x, y = (tip_pos_world[..., i] - hole_pos_world[..., i] for i in range(2))
    below = scene.plate_top_m - tip_pos_world[..., 2]
    deep = (below >= depth_m) & (below < scene.config.hole_depth_m + BELOW_M)
    return deep & (x**2 + y**2 < BESIDE_M**2)


def resolve(name: str) -> str:
    """The engine that a name stands for: ``auto`` is MJX on an accelerator and native on a CPU.

    Raises:
        RequestError: There is no such engine.
    """
    if name not in ENGINES:
        raise RequestError(f"--engine: {shown(name)} is not allowed: choose from {', '.join(ENGINES)}")
    if name != "auto":
        return name
    return "native" if jax.default_backend() == "cpu" else "mjx"


def create(name: str, config: Config) -> Engine:
    """Makes an engine, compiled for the configuration's scene.

    Raises:
        RequestError: There is no such engine.
    """
    from mjx_fit.simulate.mjx import MjxEngine
    from mjx_fit.simulate.native import NativeEngine

    return (MjxEngine if resolve(name) == "mjx" else NativeEngine)(config, host_threads())


def silence_mujoco() -> None:
    """Keeps MuJoCo's warnings out of a file in the working folder: what breaks is in ``Interaction.valid``.

    A caller that has set a handler of its own keeps it.
    """
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(lambda message: None)


def host_threads() -> int:
    """Threads that this process may use at once: what it was granted, not all there are."""
    return granted.cpus()


def even_batch(n: int, at_most: int) -> int:
    """Size of the batches that n attempts are run in: of one shape, with little padding in the last."""
    return math.ceil(n / math.ceil(n / at_most))


def start_qpos(chain: Chain, attempts: Attempt, scene: Scene) -> Float[Array, "n 7"]:
    """Joint angles (rad) at which attempts start: the tip over the estimate, straight down."""
    height = jnp.full_like(attempts.estimate_world[:, :1], scene.plate_top_m + START_HEIGHT_M)
    return jax.vmap(inverse, (None, 0))(chain, jnp.concatenate([attempts.estimate_world, height], 1))
