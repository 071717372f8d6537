"""Contact in MJX, by ``mjx_fit.engines.mjx.collision`` and ``mjx_fit.engines.mjx.newton_solver``.

``collide``, ``solve`` and ``integrate`` replace ``mjx.collision``, ``mjx.solve`` and ``mjx.implicit`` with
the same inputs and outputs, for scenes like this project's: one arm with a peg over one socket.
``require_supported`` checks the scene. No stage of a step calls LAPACK.
"""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

from functools import partial

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Int
from mujoco import mjx

from mjx_fit.engines.mjx import collision, friction_cones, newton_solver, outline_contact
from mjx_fit.engines.mjx.outlines import Outlines
from mjx_fit.scene.placement import Setting
from mjx_fit.utils.linalg import cholesky_factor, cholesky_solve, product, times, total, worlds_last


def require_supported(model: mujoco.MjModel) -> None:
    """Check that this module supports a model; results for any other model would be wrong.

    Raises:
        ValueError: The model has another cone or integrator, contacts of other dimensions, or joints other
            than hinges with limits on both sides.
    """
    for what, holds in (
        ("an elliptic cone", model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC),
        ("the integrator implicitfast", model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST),
        ("contacts of three dimensions", (model.geom_condim[model.geom_contype != 0] == 3).all()),
        ("hinges", (model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE).all()),
        ("limits on every joint", (model.jnt_limited != 0).all()),
    ):
        if not holds:
            raise ValueError(f"the MJX engine requires {what}")


def collide(
    model: mjx.Model, outlines: Outlines | None, data: mjx.Data, setting: Setting | None = None
) -> mjx.Data:
    """Find the deepest contact points between peg and socket; see ``mjx.collision``.

    Args:
        model: The model.
        outlines: Outlines of peg and hole; None: they consist of the model's boxes.
        data: State with current positions.
        setting: Tells whether the socket is upright, and how the peg is held; None: upright and straight.
    """
    peg, plate = _geoms(model, "peg_"), _geoms(model, "hole_")
    peg_body, plate_body = (int(model.geom_bodyid[geoms[0]]) for geoms in (peg, plate))
    contact = data._impl.contact
    parts = outlines
    if parts is None:
        parts = (
            collision.Boxes(model.geom_pos[peg], model.geom_size[peg]),
            collision.Boxes(model.geom_pos[plate], model.geom_size[plate]),
        )
    find = collision.deepest_points if outlines is None else outline_contact.touching_points
    upright = setting is None or setting.socket_world is None
    held = None if setting is None else setting.peg_hand
    points = worlds_last(partial(_touching, partial(find, count=len(contact.dist))))(
        parts,
        (data.xpos[peg_body] - data.xpos[plate_body], data.xmat[peg_body]),
        None if upright else data.xmat[plate_body],
        None if held is None else (held.translation(), held.rotation().as_matrix()),
    )
    slide, spin, roll = jnp.maximum(model.geom_friction[peg[0]], mujoco.mjMINMU)  # as in the C engine
    # All boxes share the same friction and stiffness, so one box represents its body.
    contact = contact.replace(
        dist=points.dist,
        pos=points.pos_plate + data.xpos[plate_body],
        frame=points.frame,
        geom=jnp.broadcast_to(jnp.array([peg[0], plate[0]]), contact.geom.shape),
        friction=jnp.broadcast_to(jnp.stack([slide, slide, spin, roll, roll]), contact.friction.shape),
        solref=jnp.broadcast_to(model.geom_solref[peg[0]], contact.solref.shape),
        solimp=jnp.broadcast_to(model.geom_solimp[peg[0]], contact.solimp.shape),
    )
    if model.npair:  # one time constant of friction for all
        reference = jnp.broadcast_to(model.pair_solreffriction[0], contact.solreffriction.shape)
        contact = contact.replace(solreffriction=reference)
    return data.replace(_impl=data._impl.replace(contact=contact))


def _touching(find, parts, hand, socket_axes, held) -> collision.Points:
    """Find contact points, relative to the socket's origin in the axes of the world, with worlds last.

    Args:
        find: Function of the parts, and of the peg's origin and axes in the frame of the socket.
        parts: The parts.
        hand: Origin of the hand relative to the socket's, m, and its axes as columns, in the world's axes.
        socket_axes: Axes of the socket as columns; None: it is upright.
        held: Origin (m) and axes of the peg in the frame of the hand; None: the same.
    """
    pos, axes = hand
    if held is not None:
        pos, axes = pos + times(axes, held[0]), product(axes, held[1])
    if socket_axes is None:
        return find(*parts, pos, axes)
    from_world = socket_axes.swapaxes(0, 1)
    points = find(*parts, times(from_world, pos), product(from_world, axes))
    return points._replace(
        pos_plate=total(points.pos_plate[:, None] * socket_axes, 2),
        frame=total(points.frame[:, :, None] * socket_axes, 3),
    )


def solve(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """Compute the accelerations without and with limit and contact forces; see ``mjx.solve``."""
    impl = data._impl
    contacts = len(impl.contact.dist)
    solution = worlds_last(_solve)(
        mjx.full_m(model, data),
        data.qfrc_smooth,
        (impl.efc_J, impl.efc_aref, impl.efc_D),
        impl.contact.friction[0, 0],
        jnp.asarray(model.opt.impratio),
        data.qacc_warmstart,
    )
    force = jnp.concatenate([solution.limit_force, solution.contact_force.reshape(3 * contacts)])
    return data.replace(
        qacc=solution.acc,
        qacc_smooth=solution.smooth_acc,
        qfrc_constraint=solution.torque,
        _impl=impl.replace(efc_force=force),
    )


def _solve(mass_matrix, torque, efc, friction, impratio, guess) -> newton_solver.Solution:
    """Convert MJX's constraint rows (limits first, then contacts) to a problem, and solve it."""
    jac, acc, weight = efc
    n = len(torque)
    contacts = friction_cones.from_rows(
        jac[n:].reshape(-1, 3, *jac.shape[1:]),
        acc[n:].reshape(-1, 3, *acc.shape[1:]),
        weight[n::3],
        friction,
        impratio,
    )
    limit_side = jnp.stack([jac[i, i] for i in range(n)])
    problem = newton_solver.Problem(mass_matrix, torque, limit_side, acc[:n], weight[:n], contacts)
    return newton_solver.solve(problem, guess)


def integrate(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """Advance the state with MuJoCo's integrator ``implicitfast``; see ``mjx.implicit``.

    The integrator treats the joint damping implicitly: (M + Δt B) a = all torques. All joints are hinges.
    """
    step = model.opt.timestep
    velocity = worlds_last(_next_velocity)(
        mjx.full_m(model, data),
        step * model.dof_damping,
        step * (data.qfrc_smooth + data.qfrc_constraint),
        data.qvel,
    )
    return data.replace(
        qpos=data.qpos + step * velocity,
        qvel=velocity,
        time=data.time + step,
        qacc_warmstart=data.qacc,
    )


def _next_velocity(mass_matrix, damping, impulse, velocity):
    matrix = mass_matrix + jnp.eye(len(damping))[:, :, None] * damping
    return velocity + cholesky_solve(cholesky_factor(matrix), impulse)


def _geoms(model: mjx.Model, prefix: str) -> Int[np.ndarray, "n"]:
    """Return the ids of the geoms ``prefix0``, ``prefix1`` and so on."""
    found = []
    while (geom := mjx.name2id(model, mujoco.mjtObj.mjOBJ_GEOM, f"{prefix}{len(found)}")) >= 0:
        found.append(geom)
    return np.array(found)
