"""The forces of joint limits and contacts of all worlds at once: MuJoCo's convex problem, by Newton's method.

    min over a:  ½ aᵀ M a - aᵀ τ + Σ ½ D min(0, ±a - a_ref)² over the limits + cost of the contacts' cones

with a the joint accelerations and τ all other torques. The minimum is unique, so that this is what MuJoCo's
own solvers converge to. MJX's takes many times as long on a CPU (experiments/physics/mjx_profile.py): its
line search always makes all of its steps, and it calls LAPACK for every world.

Arrays have the worlds last, one axis of them: see ``utils.linalg``. Each world's result is its own: a world
that is solved is not touched again while others are not.
"""

from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from mjx_fit.engines.mjx import friction_cones
from mjx_fit.engines.mjx.friction_cones import Cones
from mjx_fit.types import Array
from mjx_fit.utils.linalg import cholesky_factor, cholesky_solve, times, total

ITERATIONS = 10
"""Newton steps at most: all worlds wait for the slowest. Two or three mostly do; C's limit is 8."""
_LINE_SEARCH = 10
_TOLERANCE = 1e-4
"""A world is solved when no part of the gradient is above this share of the torques that it balances."""
_SLOPE_LEFT = 0.1
"""A line search ends where this share of the first slope is left: the next Newton step does the rest."""
_FAR = 1e6


class Problem(NamedTuple):
    """One convex problem for each world.

    Attributes:
        mass_matrix: M, kg·m².
        torque: τ, N·m.
        limit_side: For each joint 1 at its lower limit, -1 at its upper one, 0 away from both.
        limit_acc: Reference accelerations a_ref of the limits, rad/s².
        limit_weight: Their D.
        contacts: The contacts.
    """

    mass_matrix: Float[Array, "joints joints b"]
    torque: Float[Array, "joints b"]
    limit_side: Float[Array, "joints b"]
    limit_acc: Float[Array, "joints b"]
    limit_weight: Float[Array, "joints b"]
    contacts: Cones


class Solution(NamedTuple):
    """What the constraints do.

    Attributes:
        acc: Joint accelerations a, rad/s².
        smooth_acc: Those without constraints, M⁻¹ τ, rad/s².
        torque: What the constraints add to τ, N·m.
        limit_force: Torques of the limits, N·m.
        contact_force: Forces of the contacts along their axes, N.
    """

    acc: Float[Array, "joints b"]
    smooth_acc: Float[Array, "joints b"]
    torque: Float[Array, "joints b"]
    limit_force: Float[Array, "joints b"]
    contact_force: Float[Array, "c 3 b"]


class _Local(NamedTuple):
    """The cost's gradient and Hessian, and whether the gradient is yet to vanish."""

    gradient: Float[Array, "joints b"]
    hessian: Float[Array, "joints joints b"]
    unsolved: Bool[Array, "b"]


def solve(problem: Problem, guess: Float[Array, "joints b"]) -> Solution:
    """Solves every world's problem.

    Args:
        problem: The problems.
        guess: Joint accelerations to begin from where they cost less than those without constraints, rad/s².
    """
    smooth_acc = cholesky_solve(cholesky_factor(problem.mass_matrix), problem.torque)
    start = jnp.where(_cost(problem, guess) < _cost(problem, smooth_acc), guess, smooth_acc)

    def goes_on(carry):
        step, _, local = carry
        return (step < ITERATIONS) & local.unsolved.any()

    def newton(carry):
        step, acc, local = carry
        direction = -cholesky_solve(cholesky_factor(local.hessian), local.gradient)
        length = _line_search(problem, acc, direction, local.unsolved)
        acc = jnp.where(local.unsolved, acc + length * direction, acc)
        return step + 1, acc, _local(problem, acc)

    acc = jax.lax.while_loop(goes_on, newton, (0, start, _local(problem, start)))[1]
    limit_force = -_limit_slope(problem, problem.limit_side * acc - problem.limit_acc)
    gradient_u, _ = friction_cones.derivatives(
        problem.contacts, friction_cones.residual(problem.contacts, acc)
    )
    torque = problem.limit_side * limit_force - _joint_torque(problem.contacts, gradient_u)
    return Solution(acc, smooth_acc, torque, limit_force, -problem.contacts.scale * gradient_u)


def _cost(problem: Problem, acc: Float[Array, "joints b"]) -> Float[Array, "b"]:
    """What is minimised."""
    inertial = total(acc * (0.5 * times(problem.mass_matrix, acc) - problem.torque))
    limit = jnp.minimum(problem.limit_side * acc - problem.limit_acc, 0)
    contact = friction_cones.cost(problem.contacts, friction_cones.residual(problem.contacts, acc))
    return inertial + 0.5 * total(problem.limit_weight * limit**2) + contact


def _local(problem: Problem, acc: Float[Array, "joints b"]) -> _Local:
    inertial = times(problem.mass_matrix, acc) - problem.torque
    limit = problem.limit_side * acc - problem.limit_acc
    gradient_u, hessian_u = friction_cones.derivatives(
        problem.contacts, friction_cones.residual(problem.contacts, acc)
    )
    torque = _joint_torque(problem.contacts, gradient_u) + problem.limit_side * _limit_slope(problem, limit)
    stiffness = jnp.where(limit < 0, problem.limit_weight, 0.0) * problem.limit_side**2
    hessian = problem.mass_matrix + jnp.eye(len(acc))[:, :, None] * stiffness
    gradient = inertial + torque
    # False for a world that is not finite: it keeps none waiting.
    unsolved = _largest(gradient) > _TOLERANCE * (_largest(inertial) + _largest(torque))
    return _Local(gradient, hessian + friction_cones.hessian(problem.contacts, hessian_u), unsolved)


def _line_search(
    problem: Problem,
    acc: Float[Array, "joints b"],
    direction: Float[Array, "joints b"],
    wanted: Bool[Array, "b"],
) -> Float[Array, "b"]:
    """Length of the step along a direction, where it is wanted; zero where the cost does not fall along it.

    Newton's method on the slope, between two points that enclose its zero; where it leaves them, bisection.
    """
    slope_at = _along(problem, acc, direction)
    zero = jnp.zeros(acc.shape[1:])
    first, _ = slope_at(zero)

    def goes_on(carry):
        count, going, *_ = carry
        return (count < _LINE_SEARCH) & going.any()

    def closer(carry):
        count, going, found, at, low, high = carry
        slope, bend = slope_at(at)
        found = jnp.where(going, at, found)
        going = going & (abs(slope) > _SLOPE_LEFT * abs(first))
        low, high = jnp.where(slope < 0, at, low), jnp.where(slope < 0, high, at)
        newton = at - slope / bend
        outside = jnp.where(high < _FAR, 0.5 * (low + high), 2 * at)
        at = jnp.where((newton > low) & (newton < high), newton, outside)
        return count + 1, going, found, at, low, high

    start = (0, wanted & (first < 0), zero, zero + 1, zero, zero + _FAR)
    return jax.lax.while_loop(goes_on, closer, start)[2]


def _along(problem: Problem, acc: Float[Array, "joints b"], direction: Float[Array, "joints b"]):
    """The cost's slope and curvature as a function of how far one goes from a point along a direction."""
    inertia = times(problem.mass_matrix, direction)
    square, linear = total(direction * inertia), total(acc * inertia) - total(direction * problem.torque)
    limit, limit_speed = problem.limit_side * acc - problem.limit_acc, problem.limit_side * direction
    u, speed = friction_cones.residual(problem.contacts, acc), total(problem.contacts.jac * direction, 2)

    def slope_at(at):
        gradient, hessian = friction_cones.derivatives(problem.contacts, u + at * speed)
        reached = limit + at * limit_speed
        slope = linear + at * square + total(total(gradient * speed))
        slope += total(_limit_slope(problem, reached) * limit_speed)
        stiffness = jnp.where(reached < 0, problem.limit_weight, 0.0)
        bend = square + total(friction_cones.curvature(hessian, speed)) + total(stiffness * limit_speed**2)
        return slope, bend

    return slope_at


def _limit_slope(problem: Problem, limit: Float[Array, "joints b"]) -> Float[Array, "joints b"]:
    return problem.limit_weight * jnp.minimum(limit, 0)


def _joint_torque(contacts: Cones, gradient_u: Float[Array, "c 3 b"]) -> Float[Array, "joints b"]:
    return total(total(contacts.jac * gradient_u[:, :, None]))


def _largest(vector: Float[Array, "n b"]) -> Float[Array, "b"]:
    return reduce(jnp.maximum, abs(vector))
