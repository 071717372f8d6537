"""Kinematics of the arm, for logs that have the angles of its joints in place of the tool's pose."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from mjx_fit.config.schema import Config
from mjx_fit.control.kinematics import chain_of, forward
from mjx_fit.scene.build import simulation_scene


def tool_poses(
    angles_rad: Float[np.ndarray, "M joints"], config: Config
) -> tuple[Float[np.ndarray, "M 3"], Rotation]:
    """Return positions (m) and orientations of the TCP in the world, accurate to some micrometres."""
    scene = simulation_scene(config.scene)
    chain = chain_of(scene.models[0], scene.robot)
    reach = jax.jit(jax.vmap(lambda angles: forward(chain, angles)[:2]))
    position, frame = reach(jnp.asarray(angles_rad, jnp.float32))
    return np.asarray(position, float), Rotation.from_matrix(np.asarray(frame, float))
