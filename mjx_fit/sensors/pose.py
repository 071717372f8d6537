"""Measurement of pose and twist of the TCP: delay, calibration, noise and resolution of one reading."""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxlie import SO3
from jaxtyping import Float, Key

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.measurement import PoseConfig
from mjx_fit.filters import frame
from mjx_fit.filters.frame import Frame
from mjx_fit.scene.parts import plate_top_m, start_tip_m
from mjx_fit.types import Array, Felt, StartPose, Trace
from mjx_fit.utils.arrays import is_off
from mjx_fit.utils.rates import ACTION_S


def measured_trace(
    trace: Trace, offset_key: Key[Array, ""], noise_key: Key[Array, ""], pose: PoseConfig
) -> Trace:
    """Return the trace of one attempt with pose and twist as a robot measures them; commands stay.

    A delay shows the pose of a moment before, interpolated between rows. The offsets of position and height
    are constant over the rows.

    Args:
        trace: Rows of one attempt (L, ...), exact.
        offset_key: Random key of the errors that are constant in an attempt.
        noise_key: Random key of the noise.
        pose: The errors.
    """
    delayed = trace if is_off(pose.delay_s) else _delayed(trace, pose.delay_s)
    keys = jax.random.split(noise_key, 4)
    shape = trace.tip_pos_world.shape

    def noise(i: int, std: float | Array) -> Float[Array, "L 3"]:
        return jnp.zeros(shape) if is_off(std) else std * jax.random.normal(keys[i], shape)

    sizes = jnp.array([pose.position_offset_m, pose.position_offset_m, pose.height_offset_m])
    offset = sizes * jax.random.normal(jax.random.split(offset_key)[0], (3,))
    position = delayed.tip_pos_world + offset + noise(0, pose.position_noise_m)
    error = noise(1, pose.orientation_noise_rad) + rotation_offset(offset_key, pose)
    rotation = rotation_from_down(turned(delayed.tip_quat_world, error))
    return replace(
        trace,
        tip_pos_world=_rounded(position, pose.position_step_m),
        tip_quat_world=from_down(_rounded(rotation, pose.orientation_step_rad)),
        tip_linvel_world=delayed.tip_linvel_world + noise(2, pose.linear_noise_mps),
        tip_angvel_world=delayed.tip_angvel_world + noise(3, pose.angular_noise_radps),
    )


def rotation_offset(offset_key: Key[Array, ""], pose: PoseConfig) -> Float[Array, "3"]:
    """Draw the calibration error of all orientations of an attempt, a rotation vector in the world, rad."""
    return pose.rotation_offset_rad * jax.random.normal(jax.random.split(offset_key)[1], (3,))


def start_of(felt: Felt, config: Config) -> StartPose:
    """Return the pose before an attempt: as measured, or that of simulated starts."""
    if felt.start is not None:
        return felt.start
    position, turn = start_pose(felt.estimate_world, config)
    return StartPose(position, from_down(jnp.zeros_like(position) if turn is None else turn))


def start_pose(
    estimate_world: Float[Array, "*n D"], config: Config
) -> tuple[Float[Array, "*n 3"], Float[Array, "*n 3"] | None]:
    """Return where simulated attempts start, m, and how the TCP is turned from straight down, rad.

    The TCP is above the estimated socket, on its axis, and turned as it is; None: straight down.
    """
    estimate, coordinates = jnp.asarray(estimate_world), config.filter.coordinates
    height = jnp.full_like(estimate[..., :1], start_tip_m(config.scene))
    place = jnp.concatenate([estimate[..., :2], height], -1)
    if frame.is_world(coordinates):
        return place, None
    here = frame.frame_of(estimate, coordinates)
    return here.world(place, plate_top_m(config.scene)), here.rotation_world.log()


def in_frame(trace: Trace, start: StartPose, here: Frame, top_m: float) -> tuple[Trace, StartPose]:
    """Return a trace (L, ...) and the pose at its start as they are seen in the frame of the estimate.

    The wrench is the tool's in any frame.

    Args:
        trace: Rows of one attempt.
        start: Pose at its start.
        here: The frame.
        top_m: Nominal height of the socket's top, m.
    """
    back = here.rotation_world.inverse()
    seen = replace(
        trace,
        tip_pos_world=jax.vmap(lambda point: here.seen(point, top_m))(trace.tip_pos_world),
        tip_quat_world=(back @ SO3(jnp.asarray(trace.tip_quat_world))).wxyz,
        tip_linvel_world=back @ trace.tip_linvel_world,
        tip_angvel_world=back @ trace.tip_angvel_world,
        action_world=back @ trace.action_world,
    )
    quat = (back @ SO3(jnp.asarray(start.quat_world))).wxyz
    return seen, StartPose(here.seen(jnp.asarray(start.pos_world), top_m), quat)


def from_start(trace: Trace, start: StartPose) -> Trace:
    """Express the orientations of a trace relative to those at its start: q q₀⁻¹ q_down.

    A constant rotation of all orientations, such as an error of the tool's calibration, has no effect.
    """
    before = rotation_from_down(start.quat_world)
    return replace(trace, tip_quat_world=from_down(_between_rotations(trace.tip_quat_world, before)))


def _between_rotations(quat_world: Float[Array, "L 4"], start: Float[Array, "3"]) -> Float[Array, "L 3"]:
    """Return the rotation vector log(q q₀⁻¹), with q₀ = exp(start) q_down, world frame, rad."""
    # q q₀⁻¹ = (q q_down⁻¹) exp(-start): compose the two rotations as quaternions.
    inverse = turned(jnp.array([1.0, 0.0, 0.0, 0.0]), -start)
    w, v = inverse[0], inverse[1:]
    scalar, vector = _times_down_inverse(canonical(quat_world))
    product_w = scalar * w - (vector * v).sum(-1)
    product_v = scalar[..., None] * v + w * vector + jnp.cross(vector, jnp.broadcast_to(v, vector.shape))
    return _logarithm(product_w, product_v)


def is_exact(pose: PoseConfig) -> bool:
    """Return True if poses are measured without any error."""
    return all(map(is_off, vars(pose).values()))


def canonical(quat: Float[Array, "*n 4"]) -> Float[Array, "*n 4"]:
    """Return the same rotation with x >= 0: a quaternion and its negative are one rotation."""
    return jnp.where(quat[..., 1:2] < 0, -quat, quat)


def turned(quat_world: Float[Array, "*n 4"], rotation_world: Float[Array, "*#n 3"]) -> Float[Array, "*n 4"]:
    """Turn an orientation by a rotation vector in the world frame (rad): exp(φ) q."""
    half = 0.5 * rotation_world
    angle = jnp.linalg.norm(half, axis=-1, keepdims=True)
    sine = half * jnp.sinc(angle / jnp.pi)
    cosine = jnp.cos(angle)
    w, v = quat_world[..., :1], quat_world[..., 1:]
    scalar = cosine * w - (sine * v).sum(-1, keepdims=True)
    return jnp.concatenate([scalar, cosine * v + w * sine + jnp.cross(sine, v)], axis=-1)


def rotation_from_down(quat_world: Float[Array, "*n 4"]) -> Float[Array, "*n 3"]:
    """Compute the rotation vector from straight down, (0, 1, 0, 0), to an orientation, world frame, rad.

    It is log(q q_down⁻¹), the same for q and -q, and small in an attempt.
    """
    return _logarithm(*_times_down_inverse(canonical(quat_world)))


def _times_down_inverse(quat_world: Float[Array, "*n 4"]) -> tuple[Float[Array, "*n"], Float[Array, "*n 3"]]:
    """Return the scalar and the vector part of q q_down⁻¹."""
    w, x, y, z = jnp.moveaxis(quat_world, -1, 0)
    return x, jnp.stack([-w, -z, y], axis=-1)


def _logarithm(scalar: Float[Array, "*n"], vector: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    """Return the rotation vector of a unit quaternion with a positive scalar part."""
    # Regularised under the root, so that the derivative at the identity is finite.
    sine = jnp.sqrt((vector**2).sum(-1) + 1e-20)
    return vector * (2 * jnp.arctan2(sine, scalar) / sine)[..., None]


def from_down(rotation_world: Float[Array, "*n 3"]) -> Float[Array, "*n 4"]:
    """Return the orientation with this rotation vector from straight down; see ``rotation_from_down``."""
    down = jnp.broadcast_to(jnp.array([0.0, 1.0, 0.0, 0.0]), (*rotation_world.shape[:-1], 4))
    return turned(down, rotation_world)


def _delayed(trace: Trace, delay_s: float | Array) -> Trace:
    """Return pose and twist of a moment before each row, by cubic Hermite interpolation between rows.

    Before the first row, the pose is extrapolated at constant velocity.
    """
    share = 1 - delay_s / ACTION_S
    rotation, spin = rotation_from_down(trace.tip_quat_world), trace.tip_angvel_world
    position, velocity = trace.tip_pos_world, trace.tip_linvel_world
    return replace(
        trace,
        tip_pos_world=_between(position, velocity, share),
        # Rotation vectors near straight down change at the angular velocity, to second order in the tilt.
        tip_quat_world=from_down(_between(rotation, spin, share)),
        tip_linvel_world=_before(velocity) + share * (velocity - _before(velocity)),
        tip_angvel_world=_before(spin) + share * (spin - _before(spin)),
    )


def _before(rows: Float[Array, "L 3"]) -> Float[Array, "L 3"]:
    return jnp.concatenate([rows[:1], rows[:-1]])


def _between(value: Float[Array, "L 3"], slope: Float[Array, "L 3"], t: float | Array) -> Float[Array, "L 3"]:
    """Interpolate from the previous row (t = 0) to each row (t = 1)."""
    start, start_slope = _before(value), ACTION_S * _before(slope)
    inner = (
        (2 * t**3 - 3 * t**2 + 1) * start
        + (t**3 - 2 * t**2 + t) * start_slope
        + (3 * t**2 - 2 * t**3) * value
        + (t**3 - t**2) * ACTION_S * slope
    )
    first = value[:1] - (1 - t) * ACTION_S * slope[:1]
    return jnp.concatenate([first, inner[1:]])


def _rounded(value: Float[Array, "L 3"], step: float) -> Float[Array, "L 3"]:
    return jnp.round(value / step) * step if step else value
