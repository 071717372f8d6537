"""Interactions made up of random numbers, in which the wrench tells where the hole is and whether it matches."""

import jax.numpy as jnp
import numpy as np

from mjx_fit.types import Interaction, Trace


def make_interactions(episodes: int = 24, actions: int = 16, seed: int = 0, min_length: int = 8) -> Interaction:
    """Stacked interactions of random lengths; every number of a row is different, padding is zero.

    Fx and Fy are 10 N per cm of offset from the estimate to the hole, Fz is 5 N where the peg matches.
    """
    rng = np.random.default_rng(seed)
    length = rng.integers(min_length, actions + 1, episodes)
    peg_type, hole_type = (np.arange(episodes) % 3), (np.arange(episodes) // 3 % 3)
    estimate = rng.uniform(-0.3, 0.3, (episodes, 2)) + [0.5, 0.0]
    hole_pos = estimate + rng.uniform(-0.02, 0.02, (episodes, 2))
    wrench = rng.normal(0, 1.0, (episodes, actions, 50, 6))
    wrench[..., :2] += 1000 * (hole_pos - estimate)[:, None, None]
    wrench[..., 2] += 5 * (peg_type == hole_type)[:, None, None]
    tip = rng.normal(0, 0.01, (episodes, actions, 3))
    tip[..., :2] += estimate[:, None]
    trace = Trace(
        wrench_sensor=wrench,
        tip_pos_world=tip,
        tip_quat_world=rng.normal(0, 1, (episodes, actions, 4)),
        tip_linvel_world=rng.normal(0, 0.1, (episodes, actions, 3)),
        tip_angvel_world=rng.normal(0, 0.1, (episodes, actions, 3)),
        contact=rng.uniform(size=(episodes, actions)) < 0.7,
        action_world=rng.normal(0, 0.004, (episodes, actions, 3)),
    )
    real = np.arange(actions) < length[:, None]
    padded = {name: x * real.reshape(*real.shape, *[1] * (x.ndim - 2)) for name, x in vars(trace).items()}
    return Interaction(
        trace=Trace(**{name: _device(x) for name, x in padded.items()}),
        length=_device(length),
        inserted=_device((peg_type == hole_type) & (rng.uniform(size=episodes) < 0.5)),
        peg_type=_device(peg_type),
        hole_type=_device(hole_type),
        hole_pos_world=_device(hole_pos),
        estimate_world=_device(estimate),
        tare_sensor=_device(rng.normal(0, 1, (episodes, 6))),
        valid=_device(np.ones(episodes, bool)),
    )


def _device(x):
    return jnp.asarray(x, jnp.float32 if x.dtype.kind == "f" else None)
