"""The stages of a step in MJX, and the models of all pairs as one.

``mjx.step`` computes positions and velocities at its start. The controller needs them before it, so the step
is cut in two: ``observe`` ends one, ``accelerate`` begins the next.
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
    """One world at rest: the arm in a posture (rad), the box with its hole at a place (m)."""
    mocap = jnp.append(hole_pos_world, plate_top_m)[None]
    return observe(model, mjx.make_data(model).replace(qpos=qpos, mocap_pos=mocap))


def advance(
    model: mjx.Model, data: mjx.Data, torque: Float[Array, "joints"]
) -> tuple[mjx.Data, Float[Array, "6"]]:
    """One step under joint torques (N·m).

    Needs and leaves data whose position and velocity stages are current. Returns the wrench (N, N·m).
    """
    data = accelerate(model, data.replace(ctrl=torque))
    return observe(model, contact.integrate(model, data)), data.sensordata


def observe(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """The stages of ``mjx.forward`` that depend on position and velocity."""
    for stage in (mjx.kinematics, mjx.com_pos, mjx.crb, contact.collide, mjx.make_constraint):
        data = stage(model, data)
    return mjx.fwd_velocity(model, mjx.transmission(model, data))


def accelerate(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """The other stages of ``mjx.forward``, those that need the torques."""
    data = mjx.fwd_actuation(model, data)
    data = data.replace(qfrc_smooth=data.qfrc_passive - data.qfrc_bias + data.qfrc_actuator)
    return mjx.sensor_acc(model, contact.solve(model, data))


_GEOMETRY = ("geom_pos", "geom_size")
"""The model's fields in which the pairs differ."""


def stacked_models(scene: Scene) -> tuple[mjx.Model, mjx.Model]:
    """The nine models as one, with a leading axis on the geometry, and the tree of vmap axes."""
    contact.require_supported(scene.models[0])
    model = mjx.put_model(scene.models[0])
    stacked = {
        name: jnp.asarray(np.stack([getattr(pair, name) for pair in scene.models]), jnp.float32)
        for name in _GEOMETRY
    }
    axes = jax.tree.map(lambda _: None, model).replace(**dict.fromkeys(_GEOMETRY, 0))
    return model.replace(**stacked), axes


def models_of(stacked: mjx.Model, pair: Int[Array, "n"]) -> mjx.Model:
    """The models of a batch of worlds: the geometry of each world's pair."""
    return stacked.replace(**{name: getattr(stacked, name)[pair] for name in _GEOMETRY})
