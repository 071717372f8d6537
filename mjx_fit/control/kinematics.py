"""Forward and inverse kinematics of the arm in JAX, for the initial posture of an attempt.

Both engines start from the same joint angles, since these are computed here and not by a simulator.
"""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Float

from mjx_fit.scene.parts import HANGING
from mjx_fit.scene.robot import PANDA, Robot
from mjx_fit.types import Array
from mjx_fit.utils.linalg import cholesky_factor, cholesky_solve, column, cross, total
from mjx_fit.utils.pytrees import pytree, static

_ITERATIONS = 20
_DAMPING = 1e-6


@pytree
class Chain:
    """Kinematic chain of the arm.

    Attributes:
        offset: Position of each joint's frame in the previous frame, m; the last entry is the TCP.
        rotation: Orientation of each frame in the previous frame, as rotation matrices.
        robot: Robot that the chain belongs to.
    """

    offset: Float[Array, "frames 3"]
    rotation: Float[Array, "frames 3 3"]
    robot: Robot = static()


def chain_of(model: mujoco.MjModel, robot: Robot = PANDA) -> Chain:
    """Extract the chain from the base to the robot's tool site from a model."""
    offset, rotation = [], []
    position, frame = np.zeros(3), np.eye(3)
    for body in _bodies_from_base(model, model.site(robot.tool_site).bodyid[0]):
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, model.body_quat[body])
        position = position + frame @ model.body_pos[body]
        frame = frame @ matrix.reshape(3, 3)
        if model.body_jntnum[body]:
            offset.append(position)
            rotation.append(frame)
            position, frame = np.zeros(3), np.eye(3)
    offset.append(position + frame @ model.site(robot.tool_site).pos)
    rotation.append(frame)
    return Chain(jnp.asarray(offset, jnp.float32), jnp.asarray(rotation, jnp.float32), robot)


def forward(
    chain: Chain, qpos: Float[Array, "joints"]
) -> tuple[Float[Array, "3"], Float[Array, "3 3"], Float[Array, "6 joints"]]:
    """Compute the TCP's position (m) and orientation in the world, and its Jacobian (linear over angular)."""
    joints = len(chain.robot.joints)
    cos, sin, zero, one = jnp.cos(qpos), jnp.sin(qpos), jnp.zeros_like(qpos), jnp.ones_like(qpos)
    turn = jnp.stack([cos, -sin, zero, sin, cos, zero, zero, zero, one], -1).reshape(joints, 3, 3)
    position, frame = jnp.zeros(3), jnp.eye(3)
    anchors, axes = [], []
    for i in range(joints):
        position = position + frame @ chain.offset[i]
        frame = frame @ chain.rotation[i] @ turn[i]
        anchors.append(position)
        axes.append(frame[:, 2])
    position = position + frame @ chain.offset[-1]
    frame = frame @ chain.rotation[-1]
    return position, frame, jacobian(jnp.stack(anchors), jnp.stack(axes), position)


def jacobian(
    joint_anchor_world: Float[Array, "joints 3 *b"],
    joint_axis_world: Float[Array, "joints 3 *b"],
    point_world: Float[Array, "3 *b"],
) -> Float[Array, "6 joints *b"]:
    """Compute the geometric Jacobian of a point on the last body: linear over angular velocity."""
    axis, arm = joint_axis_world.swapaxes(0, 1), (point_world - joint_anchor_world).swapaxes(0, 1)
    return jnp.concatenate([cross(axis, arm), axis])


def rotation_error(
    frame_world: Float[Array, "3 3 *b"], goal_world: Float[Array, "3 3 *b"]
) -> Float[Array, "3 *b"]:
    """Compute the rotation vector (rad, world frame) from one frame to another, exact to second order.

    The result is half the sum of the axes' cross products (Siciliano et al., Robotics, section 3.7.3). A goal
    without batch axes is that of all worlds.
    """
    if goal_world.ndim == 2:
        goal_world = jnp.reshape(goal_world, (3, 3, *[1] * (frame_world.ndim - 2)))
    return 0.5 * total(cross(frame_world, goal_world), 1)


def turned_down(turn_world: Float[Array, "3 *b"]) -> Float[Array, "3 3 *b"]:
    """Return the frame that a rotation vector r (rad, world frame) makes of straight down.

    Rodrigues' formula, (1 - b r²) I + a [r]× + b r rᵀ with a = sin |r| / |r| and b = (1 - cos |r|) / r², is
    written out: the controller calls this in every step, where products of small matrices are slow.
    """
    square = total(turn_world * turn_world)
    angle = jnp.sqrt(jnp.maximum(square, 1e-12))
    half = jnp.sin(angle / 2) / (angle / 2)
    a, b = jnp.sin(angle) / angle, half * half / 2
    scaled = b * turn_world
    columns = []
    for i, side in enumerate(HANGING):
        unit = jnp.stack([jnp.full_like(square, i == j) for j in range(3)])
        rotated = (1 - b * square) * unit + a * cross(turn_world, unit) + turn_world * scaled[i]
        columns.append(side * rotated)
    return jnp.stack(columns, 1)


def posture_towards(tip_pos_world: Float[Array, "3 *b"], robot: Robot = PANDA) -> Float[Array, "joints *b"]:
    """Turn the robot's posture (rad) towards a point, keeping the peg's sides along the world axes."""
    bearing = jnp.arctan2(tip_pos_world[1], tip_pos_world[0])
    turns = np.array(robot.turns, np.float32)
    rows = jnp.broadcast_to(bearing, (len(turns), *bearing.shape))
    return column(np.asarray(robot.posture_rad), rows) + column(turns, rows) * rows


def inverse(
    chain: Chain,
    tip_pos_world: Float[Array, "3"],
    tilt_world: Float[Array, "3"] | float = 0.0,
    turn_world: Float[Array, "3"] | None = None,
) -> Float[Array, "joints"]:
    """Compute joint angles (rad) that place the TCP at a point, straight down, sides along the world axes.

    The solver is Gauss-Newton with damped least squares, started from the robot's posture turned towards the
    point. Damping does not shorten steps near the solution, so the result is accurate to float32 over the
    workspace; tests bound the error by 20 µm.

    Args:
        chain: The arm.
        tip_pos_world: Position of the TCP, m.
        tilt_world: Small rotation vector from there, rad.
        turn_world: Rotation vector from straight down, of any size, rad; None: straight down.
    """
    wanted = STRAIGHT_DOWN if turn_world is None else turned_down(turn_world)

    def step(qpos, _):
        position, frame, jac = forward(chain, qpos)
        turn = rotation_error(frame, wanted) + tilt_world
        error = jnp.concatenate([tip_pos_world - position, turn])
        return qpos + jac.T @ cholesky_solve(cholesky_factor(jac @ jac.T, _DAMPING), error), None

    return jax.lax.scan(step, posture_towards(tip_pos_world, chain.robot), length=_ITERATIONS)[0]


STRAIGHT_DOWN = np.diag(HANGING).astype(np.float32)
"""Orientation of the TCP in every attempt: z down, sides along the world axes, like those of the holes."""


def _bodies_from_base(model: mujoco.MjModel, body: int) -> list[int]:
    bodies = []
    while body != 0:
        bodies.append(body)
        body = model.body_parentid[body]
    return bodies[::-1]
