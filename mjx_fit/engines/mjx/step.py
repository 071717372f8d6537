"""Stages of a simulation step in MJX, and one stacked model for all pairs of peg and hole.

``mjx.step`` computes positions and velocities at its start. The controller needs them before the step, so the
step is split in two: ``observe`` ends one step, ``accelerate`` begins the next.
"""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from mujoco import mjx

from mjx_fit.engines.mjx import contact
from mjx_fit.scene.build import Scene
from mjx_fit.types import Array


def placed(
    model: mjx.Model, qpos: Float[Array, "joints"], hole_pos_world: Float[Array, "2"], plate_top_m: float
) -> mjx.Data:
    """Create one world at rest, with the arm in a posture (rad) and the socket at a position (m)."""
    mocap = jnp.append(hole_pos_world, plate_top_m)[None]
    return observe(model, mjx.make_data(model).replace(qpos=qpos, mocap_pos=mocap))


def advance(
    model: mjx.Model, data: mjx.Data, torque: Float[Array, "joints"]
) -> tuple[mjx.Data, Float[Array, "6"]]:
    """Take one simulation step under joint torques (N·m).

    The position and velocity stages of the data must be current, and are again on return. The function
    returns the wrench (N, N·m) as well.
    """
    data = accelerate(model, data.replace(ctrl=torque))
    return observe(model, contact.integrate(model, data)), data.sensordata


def observe(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """Run the stages of ``mjx.forward`` that depend on position and velocity."""
    for stage in (mjx.kinematics, mjx.com_pos, mjx.crb, contact.collide, mjx.make_constraint):
        data = stage(model, data)
    return mjx.fwd_velocity(model, mjx.transmission(model, data))


def accelerate(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """Run the remaining stages of ``mjx.forward``, which need the torques."""
    data = mjx.fwd_actuation(model, data)
    data = data.replace(qfrc_smooth=data.qfrc_passive - data.qfrc_bias + data.qfrc_actuator)
    return mjx.sensor_acc(model, contact.solve(model, data))


_GEOMETRY = ("geom_pos", "geom_size")
"""Fields of the model that differ between pairs."""


def stacked_models(scene: Scene) -> tuple[mjx.Model, mjx.Model]:
    """Stack the nine models along a leading axis of the geometry; return them with their vmap axes."""
    contact.require_supported(scene.models[0])
    model = mjx.put_model(scene.models[0])
    stacked = {
        name: jnp.asarray(np.stack([getattr(pair, name) for pair in scene.models]), jnp.float32)
        for name in _GEOMETRY
    }
    axes = jax.tree.map(lambda _: None, model).replace(**dict.fromkeys(_GEOMETRY, 0))
    return model.replace(**stacked), axes


def models_of(stacked: mjx.Model, pair: Int[Array, "n"]) -> mjx.Model:
    """Select the models of a batch of worlds: the geometry of each world's pair."""
    return stacked.replace(**{name: getattr(stacked, name)[pair] for name in _GEOMETRY})
