"""Stages of a simulation step in MJX, and one stacked model for all pairs of peg and hole.

``mjx.step`` computes positions and velocities at its start. The controller needs them before the step, so the
step is split in two: ``observe`` ends one step, ``accelerate`` begins the next.
"""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

import warnings
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from mujoco import mjx

from mjx_fit.control import operational_space
from mjx_fit.engines.mjx import contact
from mjx_fit.engines.mjx.outlines import Outlines, outlines_of
from mjx_fit.scene.build import Scene
from mjx_fit.scene.placement import Setting
from mjx_fit.scene.variation import Slope, longest_contact_times, offsets, slopes
from mjx_fit.types import Array
from mjx_fit.types.physics import AS_CONFIGURED, Physics


class WorldModel(NamedTuple):
    """Model of one world.

    Attributes:
        mjx: The model in MJX.
        outlines: Outlines of peg and hole; None: the boxes of the model.
        setting: Where the socket stands, and how the peg is held; None: upright and straight.
    """

    mjx: mjx.Model
    outlines: Outlines | None
    setting: Setting | None = None


def placed(
    model: WorldModel, qpos: Float[Array, "joints"], hole_pos_world: Float[Array, "2"], plate_top_m: float
) -> mjx.Data:
    """Create one world at rest, with the arm in a posture (rad) and an upright socket at a position (m)."""
    place = {"mocap_pos": jnp.append(hole_pos_world, plate_top_m)[None]}
    if model.setting is not None and model.setting.socket_world is not None:
        socket = model.setting.socket_world
        place = {"mocap_pos": socket.translation()[None], "mocap_quat": socket.rotation().wxyz[None]}
    return observe(model, mjx.make_data(model.mjx).replace(qpos=qpos, **place))


def advance(
    model: WorldModel, data: mjx.Data, torque: Float[Array, "joints"], steps: int = 1
) -> tuple[mjx.Data, Float[Array, "6"]]:
    """Take the physics steps of 2 ms under joint torques (N·m).

    The position and velocity stages of the data must be current, and are again on return. The function
    returns the wrench (N, N·m) as well.
    """

    def step(data: mjx.Data, _) -> tuple[mjx.Data, Float[Array, "6"]]:
        data = accelerate(model, data)
        return observe(model, contact.integrate(model.mjx, data)), data.sensordata

    data = data.replace(ctrl=torque)
    if steps == 1:
        return step(data, None)
    data, wrench = jax.lax.scan(step, data, length=steps)
    return data, wrench[-1]


def observe(model: WorldModel, data: mjx.Data) -> mjx.Data:
    """Run the stages of ``mjx.forward`` that depend on position and velocity."""
    for stage in (mjx.kinematics, mjx.com_pos, mjx.crb):
        data = stage(model.mjx, data)
    data = mjx.make_constraint(model.mjx, contact.collide(model.mjx, model.outlines, data, model.setting))
    return mjx.fwd_velocity(model.mjx, mjx.transmission(model.mjx, data))


def accelerate(model: WorldModel, data: mjx.Data) -> mjx.Data:
    """Run the remaining stages of ``mjx.forward``, which need the torques."""
    data = mjx.fwd_actuation(model.mjx, data)
    data = data.replace(qfrc_smooth=data.qfrc_passive - data.qfrc_bias + data.qfrc_actuator)
    return mjx.sensor_acc(model.mjx, contact.solve(model.mjx, data))


def free_reading(model: WorldModel, data: mjx.Data) -> Float[Array, "6"]:
    """Compute the reading of the F/T sensor at rest in free space, N and N·m."""
    return accelerate(model, data.replace(ctrl=data.qfrc_bias)).sensordata


_GEOMETRY = ("geom_pos", "geom_size", "geom_solref", "geom_solimp")
"""Fields of the model that differ between pairs."""


@dataclass(frozen=True)
class Models:
    """Models of all pairs, and how they depend on the physics of a world.

    Attributes:
        stacked: One model, with a leading axis of pairs in its geometry.
        scene: Scene of the models.
        outlines: Outlines of peg and hole of all pairs; None: all parts consist of boxes.
    """

    stacked: mjx.Model
    scene: Scene
    outlines: Outlines | None

    @cached_property
    def _slopes(self) -> dict[str, Slope]:
        """Derivatives of the geometry, by name of the quantity."""
        return slopes(self.scene)

    @classmethod
    def of(cls, scene: Scene) -> "Models":
        """Stack the models of a scene."""
        contact.require_supported(scene.models[0])
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Mesh .* coplanar face")  # contact is this package's own
            model = mjx.put_model(scene.models[0])
        stacked = {
            name: jnp.asarray(np.stack([getattr(pair, name) for pair in scene.models]), jnp.float32)
            for name in _GEOMETRY
        }
        return cls(model.replace(**stacked), scene, outlines_of(scene.config))

    def of_worlds(
        self, pair: Int[Array, "n"], physics: Physics = AS_CONFIGURED
    ) -> tuple[WorldModel, WorldModel]:
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
        own |= self._contact(pair, physics)
        axes = jax.tree.map(lambda _: None, self.stacked).replace(**dict.fromkeys(own, 0))
        outlines = jax.tree.map(lambda leaf: leaf[pair], self.outlines)
        drawn = jax.tree.map(lambda _: 0, self.outlines)
        return WorldModel(self.stacked.replace(**own), outlines), WorldModel(axes, drawn)

    def _contact(self, pair: Int[Array, "n"], physics: Physics) -> dict[str, Array]:
        """Return friction and stiffness of all geoms, where worlds have their own."""
        if physics.contact_time_s is not None:
            longest = jnp.asarray(longest_contact_times(self.scene.config), jnp.float32)[pair]
            physics = replace(physics, contact_time_s=jnp.minimum(physics.contact_time_s, longest))
        fields = {"geom_friction": ("friction",), "geom_solref": ("contact_time_s", "contact_damping")}
        changed = {}
        for field, names in fields.items():
            values = getattr(self.stacked, field)
            of_pairs = field in _GEOMETRY
            values = values[pair] if of_pairs else jnp.broadcast_to(values, (len(pair), *values.shape))
            drawn = {i: getattr(physics, name) for i, name in enumerate(names)}
            for column, value in drawn.items():
                if value is not None:
                    values = values.at[..., column].set(value[:, None])
                    changed[field] = values
        return changed


def arm_state(model: WorldModel, data: mjx.Data, scene: Scene) -> operational_space.ArmState:
    """Return the controller's inputs from data with current position and velocity stages."""
    tip = scene.models[0].site(scene.robot.tool_site).id
    return operational_space.ArmState(
        qpos=data.qpos,
        qvel=data.qvel,
        mass_matrix=mjx.full_m(model.mjx, data),
        bias=data.qfrc_bias,
        tip_pos_world=data.site_xpos[tip],
        tip_frame_world=data.site_xmat[tip],
        joint_anchor_world=data.xanchor,
        joint_axis_world=data.xaxis,
    )
