"""Poses of socket and peg in a world: those of the section ``placement``, or what the world drew.

A pose that is None costs no computation: the socket is upright, or the peg straight in the hand.
"""

from typing import Any

import jax.numpy as jnp
from jaxlie import SE3, SO3
from jaxtyping import Float

from mjx_fit.config.schema import Config
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.types import Array, pytree
from mjx_fit.types.physics import Physics
from mjx_fit.utils.arrays import is_off

SOCKET = ("socket_z_m", "socket_roll_rad", "socket_pitch_rad", "socket_yaw_rad")
TOOL = ("tilt_x_rad", "tilt_y_rad")
GRASP = ("grasp_x_m", "grasp_y_m", "grasp_z_m", "grasp_roll_rad", "grasp_pitch_rad", "grasp_yaw_rad")


@pytree
class Setting:
    """Where the socket stands, and how the hand holds the peg.

    Attributes:
        hole_pos_world: Centre of the hole, x and y, m.
        socket_world: Pose of the socket's frame, with its origin in the centre of the hole on the plate's
            upper face and z upwards, in the world; None: upright, at the nominal height.
        peg_tip: Pose of the peg's lower face, in the frame of the nominal TCP; None: they coincide.
        peg_hand: The same rotation and displacement, of the peg's upper end in the frame of the hand.
    """

    hole_pos_world: Float[Array, "*n 2"]
    socket_world: SE3 | None
    peg_tip: SE3 | None
    peg_hand: SE3 | None


def setting_of(hole_pos_world: Float[Array, "*n 2"], physics: Physics, config: Config) -> Setting:
    """Return the setting of worlds.

    Args:
        hole_pos_world: Centres of the holes, m.
        physics: Quantities that worlds have of their own, (*n).
        config: Values of the others.
    """
    shape, top = hole_pos_world.shape[:-1], plate_top_m(config.scene)
    own = config.placement
    socket, grasp = (_values(names, physics, own, shape) for names in (SOCKET, GRASP))
    if socket is not None:
        z, *angles = socket
        place = jnp.concatenate([jnp.asarray(hole_pos_world), top + z[..., None]], -1)
        socket = SE3.from_rotation_and_translation(SO3.from_rpy_radians(*angles), place)
    held = None
    if grasp is not None:
        shift, angles = jnp.stack(grasp[:3], -1), grasp[3:]
        grasp = SE3.from_rotation_and_translation(SO3.from_rpy_radians(*angles), shift)
        tip = SE3.from_translation(
            jnp.broadcast_to(jnp.array([0, 0, config.scene.peg_length_m]), shift.shape)
        )
        held = tip @ grasp @ tip.inverse()
    return Setting(hole_pos_world, socket, grasp, held)


def place_for_tool(
    hole_pos_world: Float[Array, "*n 2"], physics: Physics, config: Config
) -> Float[Array, "*n D"]:
    """Return where the tool has to be for the peg to be in its hole, as the place of a socket, m and rad.

    It is what an attempt can tell, and what a belief is about: the place of the socket, less the displacement
    of the peg in the hand. With T the pose of the TCP, G that of the peg's tip in its frame and S the
    socket's, the peg is in its hole if T G = S D with D straight down, so that T D⁻¹ = S D G⁻¹ D⁻¹. The robot
    takes a tilted tool (``arm.tilt_x_rad``) for a straight one, and turns it back.

    Args:
        hole_pos_world: Centres of the holes, m.
        physics: Quantities that worlds have of their own, (*n).
        config: Values of the others, and the coordinates that are believed.
    """
    coordinates, top = config.filter.coordinates, plate_top_m(config.scene)
    setting, hole = setting_of(hole_pos_world, physics, config), jnp.asarray(hole_pos_world)
    tilt = _values(TOOL, physics, config.arm, hole.shape[:-1]) if {"roll", "pitch"} & {*coordinates} else None
    if setting.socket_world is None and setting.peg_tip is None and tilt is None:
        rest = jnp.zeros((*hole.shape[:-1], len(coordinates) - 2))
        return jnp.concatenate([hole, rest], -1)
    height = jnp.full_like(hole[..., :1], top)
    socket = setting.socket_world or SE3.from_translation(jnp.concatenate([hole, height], -1))
    if setting.peg_tip is not None:
        down = SE3.from_rotation(SO3(jnp.array([0.0, 1.0, 0.0, 0.0])))
        socket = socket @ down @ setting.peg_tip.inverse() @ down.inverse()
    position, rotation = socket.translation(), socket.rotation()
    if tilt is not None:
        rotation = SO3.exp(-jnp.stack([*tilt, jnp.zeros_like(tilt[0])], -1)) @ rotation
    turn = rotation.log()
    parts = {"x": position[..., 0], "y": position[..., 1], "z": position[..., 2] - top}
    parts |= {"roll": turn[..., 0], "pitch": turn[..., 1], "yaw": turn[..., 2]}
    return jnp.stack([parts[name] for name in coordinates], -1)


def as_if_upright(peg_world: SE3, setting: Setting, top_m: float) -> SE3:
    """Move a world so that its socket is upright, at its place and the nominal height; return the peg's pose.

    Args:
        peg_world: Pose of the peg's tip, or of what stands for it.
        setting: Setting of the world.
        top_m: Nominal height of the plate's upper face, m.
    """
    if setting.socket_world is None:
        return peg_world
    seen = setting.socket_world.inverse() @ peg_world
    place = jnp.append(setting.hole_pos_world, top_m)
    return SE3.from_rotation_and_translation(seen.rotation(), seen.translation() + place)


def _values(
    names: tuple[str, ...], physics: Physics, section: Any, shape: tuple[int, ...]
) -> list[Array] | None:
    """Return these values for each world; None if all are zero."""
    values: list[Any] = [getattr(physics, name) for name in names]
    values = [
        getattr(section, name) if value is None else value for name, value in zip(names, values, strict=True)
    ]
    if all(is_off(value) for value in values):
        return None
    return [jnp.broadcast_to(jnp.asarray(value, jnp.float32), shape) for value in values]
