"""Contact in MJX, by ``mjx_fit.simulate.boxes`` and ``mjx_fit.simulate.constraints``.

``collide`` stands in the place of ``mjx.collision`` and ``solve`` in that of ``mjx.solve``: both take and leave what
those do, in scenes like this project's, one peg over one plate.
"""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Int
from mujoco import mjx

from mjx_fit.simulate import boxes, constraints


def worlds_last(function: Callable) -> Callable:
    """A function of arrays (..., worlds), as one of arrays (...) that vmap runs in that layout."""

    def of_worlds(*args):
        last = jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), args)
        return jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), function(*last))

    @jax.custom_batching.custom_vmap
    def of_one(*args):
        return jax.tree.map(lambda x: x[0], of_worlds(*jax.tree.map(lambda x: x[None], args)))

    @of_one.def_vmap
    def _(size, batched, *args):
        def spread(x, has_worlds):
            return x if has_worlds else jnp.broadcast_to(x, (size, *x.shape))

        result = of_worlds(*jax.tree.map(spread, args, tuple(batched)))
        return result, jax.tree.map(lambda _: True, result)

    return of_one


def collide(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """Finds the deepest contact points of the peg and the plate; see ``mjx.collision``."""
    peg, plate = _geoms(model, "peg_box"), _geoms(model, "hole_box")
    peg_body, plate_body = (int(model.geom_bodyid[geoms[0]]) for geoms in (peg, plate))
    contact = data._impl.contact
    points = worlds_last(partial(boxes.deepest_points, count=len(contact.dist)))(
        model.geom_pos[peg],
        model.geom_size[peg],
        model.geom_pos[plate],
        model.geom_size[plate],
        data.xpos[peg_body] - data.xpos[plate_body],
        data.xmat[peg_body],
    )
    slide, spin, roll = model.geom_friction[peg[0]]
    # All boxes are alike in friction and stiffness, so that any one of each body stands for the others.
    contact = contact.replace(
        dist=points.dist,
        pos=points.pos_plate + data.xpos[plate_body],
        frame=points.frame,
        geom=jnp.broadcast_to(jnp.array([peg[0], plate[0]]), contact.geom.shape),
        friction=jnp.broadcast_to(jnp.stack([slide, slide, spin, roll, roll]), contact.friction.shape),
        solref=jnp.broadcast_to(model.geom_solref[peg[0]], contact.solref.shape),
        solimp=jnp.broadcast_to(model.geom_solimp[peg[0]], contact.solimp.shape),
    )
    return data.replace(_impl=data._impl.replace(contact=contact))


def solve(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """Finds the forces of limits and contacts; see ``mjx.solve``."""
    impl = data._impl
    limits, contacts = impl.nl, len(impl.contact.dist)
    jac, acc, weight = impl.efc_J, impl.efc_aref, impl.efc_D
    problem = constraints.Problem(
        mass_matrix=mjx.full_m(model, data),
        smooth_acc=data.qacc_smooth,
        limit_side=jnp.diagonal(jac[:limits]),
        limit_acc=acc[:limits],
        limit_weight=weight[:limits],
        contact_jac=jac[limits:].reshape(contacts, 3, -1),
        contact_acc=acc[limits:].reshape(contacts, 3),
        contact_weight=weight[limits::3],
        friction=impl.contact.friction[0, 0],
        impratio=jnp.asarray(model.opt.impratio),
    )
    solution = worlds_last(constraints.solve)(problem, data.qacc_warmstart)
    force = jnp.concatenate([solution.limit_force, solution.contact_force.reshape(-1)])
    return data.replace(
        qacc=solution.acc, qfrc_constraint=solution.torque, _impl=impl.replace(efc_force=force)
    )


def _geoms(model: mjx.Model, prefix: str) -> Int[np.ndarray, "n"]:
    """Ids of the geoms ``prefix0``, ``prefix1`` and so on."""
    found = []
    while (geom := mjx.name2id(model, mujoco.mjtObj.mjOBJ_GEOM, f"{prefix}{len(found)}")) >= 0:
        found.append(geom)
    return np.array(found)
