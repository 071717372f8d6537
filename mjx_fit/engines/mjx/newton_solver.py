"""Solve MuJoCo's convex constraint problem for all worlds at once, by Newton's method.

The solution gives the forces of joint limits and contacts:

    min over a:  ½ aᵀ M a - aᵀ τ + Σ ½ D min(0, ±a - a_ref)² over the limits + cost of the contacts' cones

The unknown a is the vector of joint accelerations, and τ is the sum of all other torques. The minimum is
unique, so MuJoCo's own solvers converge to the same result. MJX's solver takes many times as long on a CPU
(experiments/physics/mjx_profile.py): its line search always takes all of its steps, and it calls LAPACK for
every world.

The worlds are the last axis of all arrays: see ``mjx_fit.utils.linalg``. The result of a world is independent
of the others: a solved world stays unchanged while others iterate.
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
"""Maximum number of Newton steps; all worlds wait for the slowest. Usually 2 or 3 suffice; C allows 8."""
_LINE_SEARCH = 10
_TOLERANCE = 1e-4
"""Convergence threshold: largest gradient component relative to the torques that it balances."""
_SLOPE_LEFT = 0.1
"""Fraction of the initial slope that ends a line search; the next Newton step reduces the rest."""
_FAR = 1e6


class Problem(NamedTuple):
    """One convex problem for each world.

    Attributes:
        mass_matrix: Mass matrix M, kg·m².
        torque: Torques τ, N·m.
        limit_side: Active limit of each joint: 1 lower, -1 upper, 0 neither.
        limit_acc: Reference accelerations a_ref of the limits, rad/s².
        limit_weight: Weights D of the limits.
        contacts: Contacts of the world.
    """

    mass_matrix: Float[Array, "joints joints b"]
    torque: Float[Array, "joints b"]
    limit_side: Float[Array, "joints b"]
    limit_acc: Float[Array, "joints b"]
    limit_weight: Float[Array, "joints b"]
    contacts: Cones


class Solution(NamedTuple):
    """Solution of the constraint problem.

    Attributes:
        acc: Joint accelerations a, rad/s².
        smooth_acc: Joint accelerations without constraints, M⁻¹ τ, rad/s².
        torque: Constraint torques, to be added to τ, N·m.
        limit_force: Torques of the limits, N·m.
        contact_force: Forces of the contacts along their axes, N.
    """

    acc: Float[Array, "joints b"]
    smooth_acc: Float[Array, "joints b"]
    torque: Float[Array, "joints b"]
    limit_force: Float[Array, "joints b"]
    contact_force: Float[Array, "c 3 b"]


class _Local(NamedTuple):
    """Gradient and Hessian of the cost, and a mask of the worlds that have not converged."""

    gradient: Float[Array, "joints b"]
    hessian: Float[Array, "joints joints b"]
    unsolved: Bool[Array, "b"]


def solve(problem: Problem, guess: Float[Array, "joints b"]) -> Solution:
    """Solve the problem of every world.

    Args:
        problem: The problems.
        guess: Initial joint accelerations, rad/s²; replaced by the unconstrained ones where those cost less.
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
    """Compute the cost, which the solver minimises."""
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
    # False for a non-finite world, so that it never delays the others.
    unsolved = _largest(gradient) > _TOLERANCE * (_largest(inertial) + _largest(torque))
    return _Local(gradient, hessian + friction_cones.hessian(problem.contacts, hessian_u), unsolved)


def _line_search(
    problem: Problem,
    acc: Float[Array, "joints b"],
    direction: Float[Array, "joints b"],
    wanted: Bool[Array, "b"],
) -> Float[Array, "b"]:
    """Compute the step length along a direction for the wanted worlds; zero where the cost does not decrease.

    The search applies Newton's method to the slope, between two points that bracket its zero, and falls back
    to bisection outside of the bracket.
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
    """Return a function from step length to slope and curvature of the cost along a direction."""
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
