"""Stages of a simulation step in MJX, and one stacked model for all pairs of peg and hole.

``mjx.step`` computes positions and velocities at its start. The controller needs them before the step, so the
step is split in two: ``observe`` ends one step, ``accelerate`` begins the next.
"""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from mujoco import mjx

from mjx_fit.engines.mjx import contact
from mjx_fit.scene.build import Scene
from mjx_fit.scene.variation import Slope, offsets, slopes
from mjx_fit.types import Array
from mjx_fit.types.physics import AS_CONFIGURED, Physics


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


@dataclass(frozen=True)
class Models:
    """Models of all pairs, and how they depend on the physics of a world.

    Attributes:
        stacked: One model, with a leading axis of pairs in its geometry.
        scene: Scene of the models.
    """

    stacked: mjx.Model
    scene: Scene

    @cached_property
    def _slopes(self) -> dict[str, Slope]:
        """Derivatives of the geometry, by name of the quantity."""
        return slopes(self.scene)

    @classmethod
    def of(cls, scene: Scene) -> "Models":
        """Stack the models of a scene."""
        contact.require_supported(scene.models[0])
        model = mjx.put_model(scene.models[0])
        stacked = {
            name: jnp.asarray(np.stack([getattr(pair, name) for pair in scene.models]), jnp.float32)
            for name in _GEOMETRY
        }
        return cls(model.replace(**stacked), scene)

    def of_worlds(
        self, pair: Int[Array, "n"], physics: Physics = AS_CONFIGURED
    ) -> tuple[mjx.Model, mjx.Model]:
        """Select the models of a batch of worlds; return them with their vmap axes.

        Args:
            pair: Index of each world's pair of peg and hole.
            physics: Quantities of the worlds, (n,).
        """
        own = {name: getattr(self.stacked, name)[pair] for name in _GEOMETRY}
        for name, by in offsets(self.scene, physics).items():
            slope = self._slopes[name]
            for field, change in (("geom_pos", slope.pos), ("geom_size", slope.size)):
                own[field] += by[:, None, None] * jnp.asarray(change, jnp.float32)[pair]
        own |= self._contact(physics, len(pair))
        axes = jax.tree.map(lambda _: None, self.stacked).replace(**dict.fromkeys(own, 0))
        return self.stacked.replace(**own), axes

    def _contact(self, physics: Physics, n: int) -> dict[str, Array]:
        """Return friction and stiffness of all geoms, where worlds have their own."""
        fields = {"geom_friction": ("friction",), "geom_solref": ("contact_time_s", "contact_damping")}
        changed = {}
        for field, names in fields.items():
            values = jnp.broadcast_to(getattr(self.stacked, field), (n, *getattr(self.stacked, field).shape))
            drawn = {i: getattr(physics, name) for i, name in enumerate(names)}
            for column, value in drawn.items():
                if value is not None:
                    values = values.at[..., column].set(value[:, None])
                    changed[field] = values
        return changed
