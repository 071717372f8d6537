"""The contact forces of all worlds at once: MuJoCo's convex problem, by Newton's method in closed form.

    min over a:  ½ (a - a₀)ᵀ M (a - a₀) + Σ over rows and contacts of s(J a - a_ref)

with a the joint accelerations, a₀ those without contact, and s the costs of MuJoCo's computation chapter: a
one-sided parabola for a joint limit, the cost of an elliptic friction cone for a contact. The minimum is unique,
so that what comes out is what MuJoCo's own solvers converge to; MJX's takes ten times as long on a CPU, most of
it in a line search that always makes all of its steps, and calls LAPACK for every world.

Arrays have the worlds, ``b``, last, as in ``mjx_fit.simulate.boxes``.
"""

from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from mjx_fit import spd
from mjx_fit.lanes import times, total
from mjx_fit.types import Array

ITERATIONS = 8
LINE_SEARCH = 10
_TOLERANCE = 3e-5
"""A world is solved when no part of the gradient is above this share of the torques that it balances."""
_SLOPE_LEFT = 0.1
"""A line search ends where this share of the slope at its start is left."""
_FAR = 1e6
_SMALL = 1e-12
_LEAST_FRICTION = 1e-5
"""MuJoCo's own bound."""


class Problem(NamedTuple):
    """One convex problem for each world.

    Attributes:
        mass_matrix: M, kg·m².
        smooth_acc: a₀, rad/s².
        limit_side: For each joint 1 at its lower limit, -1 at its upper one, 0 away from both.
        limit_acc: Their reference accelerations a_ref.
        limit_weight: Their D: 1 / regularisation.
        contact_jac: Rows of the contacts: normal, and two tangents.
        contact_acc: Their reference accelerations a_ref, m/s².
        contact_weight: D of their normals.
        friction: Coefficient of friction, of all contacts.
        impratio: MuJoCo's impratio.
    """

    mass_matrix: Float[Array, "7 7 b"]
    smooth_acc: Float[Array, "7 b"]
    limit_side: Float[Array, "7 b"]
    limit_acc: Float[Array, "7 b"]
    limit_weight: Float[Array, "7 b"]
    contact_jac: Float[Array, "c 3 7 b"]
    contact_acc: Float[Array, "c 3 b"]
    contact_weight: Float[Array, "c b"]
    friction: Float[Array, "b"]
    impratio: Float[Array, "b"]


class Solution(NamedTuple):
    """What the constraints do.

    Attributes:
        acc: Joint accelerations, rad/s².
        torque: What the constraints add to the joint torques, N·m.
        limit_force: Torques of the limits, N·m.
        contact_force: Forces of the contacts along their axes, N.
    """

    acc: Float[Array, "7 b"]
    torque: Float[Array, "7 b"]
    limit_force: Float[Array, "7 b"]
    contact_force: Float[Array, "c 3 b"]


class _Cones(NamedTuple):
    """Contacts in coordinates in which friction cones are circular: u = S (J a - a_ref), S = diag(μ, f, f).

    With N = u₀ and T = |u₁₂| the cost is ½ w times: nothing where N ≥ μ T; (N - μ T)² / (1 + μ²) on the cone;
    N² + T² where μ N + T ≤ 0.

    Attributes:
        mu: μ = f / √impratio.
        weight: w = D / μ².
        scale: S.
        jac: S J.
        reference: S a_ref.
    """

    mu: Float[Array, "b"]
    weight: Float[Array, "c b"]
    scale: Float[Array, "3 b"]
    jac: Float[Array, "c 3 7 b"]
    reference: Float[Array, "c 3 b"]


def solve(problem: Problem, guess: Float[Array, "7 b"]) -> Solution:
    """Solves every world's problem, each as if it were alone.

    Args:
        problem: The problems.
        guess: Joint accelerations to begin from where they are better than a₀, rad/s².
    """
    cones = _cones(problem)
    better = _cost(problem, cones, guess) < _cost(problem, cones, problem.smooth_acc)
    start = jnp.where(better, guess, problem.smooth_acc)

    def unsolved(carry):
        step, _, (_, _, going) = carry
        return (step < ITERATIONS) & going.any()

    def newton(carry):
        step, acc, (gradient, hessian, going) = carry
        direction = -spd.solve(spd.factor(hessian), gradient)
        way = _line_search(problem, cones, acc, direction, going)
        acc = jnp.where(going, acc + way * direction, acc)
        return step + 1, acc, _derivatives(problem, cones, acc)

    _, acc, _ = jax.lax.while_loop(unsolved, newton, (0, start, _derivatives(problem, cones, start)))
    limit_force, contact_force = _forces(problem, cones, acc)
    return Solution(acc, _torque(problem, limit_force, contact_force), limit_force, contact_force)


def _cones(problem: Problem) -> _Cones:
    friction = jnp.maximum(problem.friction, _LEAST_FRICTION)
    mu = friction / jnp.sqrt(problem.impratio)
    scale = jnp.stack([mu, friction, friction])
    jac, reference = problem.contact_jac * scale[:, None], problem.contact_acc * scale
    return _Cones(mu, problem.contact_weight / mu**2, scale, jac, reference)


def _cost(problem: Problem, cones: _Cones, acc):
    """The function that is minimised."""
    off = acc - problem.smooth_acc
    limit, (normal, tangent) = _residuals(problem, cones, acc)
    size = _norm(tangent)
    below, bottom = _zones(cones.mu, normal, size)
    cone = jnp.where(
        bottom, normal**2 + size**2, jnp.where(below, (normal - cones.mu * size) ** 2 / (1 + cones.mu**2), 0.0)
    )
    limits = problem.limit_weight * jnp.minimum(limit, 0) ** 2
    return 0.5 * (total(off * times(problem.mass_matrix, off)) + total(cones.weight * cone) + total(limits))


def _residuals(problem: Problem, cones: _Cones, acc):
    """J a - a_ref of the limits, and u of the contacts as its normal and its tangents."""
    limit = problem.limit_side * acc - problem.limit_acc
    u = total(cones.jac * acc, 2) - cones.reference
    return limit, (u[:, 0], u[:, 1:])


def _zones(mu, normal, size):
    """Whether a contact is below its cone's upper side (it pushes), and below its lower side (it sticks)."""
    return normal < mu * size, mu * normal + size <= 0


def _norm(tangent):
    return jnp.sqrt(tangent[:, 0] ** 2 + tangent[:, 1] ** 2)


def _slopes(cones: _Cones, normal, tangent):
    """The cost's gradient in u, (c, *b) and (c, 2, *b), and what its Hessian is made of.

    With t the tangent's direction, the Hessian is [[n, -c tᵀ], [-c t, r t tᵀ + q (1 - t tᵀ)]].
    """
    mu, size = cones.mu, _norm(tangent)
    below, bottom = _zones(mu, normal, size)
    on_cone = cones.weight * jnp.where(below & ~bottom, 1 / (1 + mu**2), 0.0)
    inside = cones.weight * jnp.where(bottom & (normal < 0), 1.0, 0.0)
    safe = jnp.maximum(size, _SMALL)
    way, over = tangent / safe[:, None], normal - mu * size
    slope_normal = on_cone * over + inside * normal
    slope_tangent = (-mu * on_cone * over)[:, None] * way + inside[:, None] * tangent
    bend = -mu * on_cone * over / safe + inside
    return slope_normal, slope_tangent, (way, on_cone + inside, mu * on_cone, mu**2 * on_cone + inside, bend)


def _derivatives(problem: Problem, cones: _Cones, acc):
    """Gradient and Hessian of the cost in the accelerations, and whether the gradient is yet to vanish."""
    limit, (normal, tangent) = _residuals(problem, cones, acc)
    slope_normal, slope_tangent, (way, n, c, r, q) = _slopes(cones, normal, tangent)
    pushed = problem.limit_weight * jnp.where(limit < 0, 1.0, 0.0)
    inertial = times(problem.mass_matrix, acc - problem.smooth_acc)
    slope = jnp.concatenate([slope_normal[:, None], slope_tangent], 1)
    torque = total(total(cones.jac * slope[:, :, None])) + problem.limit_side * pushed * limit

    def add(hessian, contact):
        (j0, j1, j2), (t1, t2), n, c, r, q = contact
        along, across = t1 * j1 + t2 * j2, t1 * j2 - t2 * j1
        normal = n * j0 - c * along
        tangential = r * along - c * j0
        return hessian + (j0[:, None] * normal + along[:, None] * tangential + across[:, None] * (q * across)), None

    limits = jnp.eye(len(limit))[:, :, None] * (pushed * problem.limit_side**2)
    hessian = jax.lax.scan(add, problem.mass_matrix + limits, (cones.jac, way, n, c, r, q), unroll=8)[0]
    gradient = inertial + torque
    # False for a world that is not finite: it keeps none waiting.
    going = _largest(gradient) > _TOLERANCE * (_largest(inertial) + _largest(torque))
    return gradient, hessian, going


def _line_search(problem: Problem, cones: _Cones, acc, direction, going):
    """How far to go along a direction: Newton on the slope, kept between points that are known to enclose it."""
    inertia = times(problem.mass_matrix, direction)
    limit, (normal, tangent) = _residuals(problem, cones, acc)
    limit_way = problem.limit_side * direction
    way = total(cones.jac * direction, 2)
    square = total(direction * inertia)
    linear = total((acc - problem.smooth_acc) * inertia)

    def slopes(at):
        n, t = normal + at * way[:, 0], tangent + at * way[:, 1:]
        slope_n, slope_t, (to, nn, nc, r, q) = _slopes(cones, n, t)
        low = limit + at * limit_way
        pushed = problem.limit_weight * jnp.where(low < 0, limit_way, 0.0)
        slope = linear + at * square + total(pushed * low)
        slope += total(slope_n * way[:, 0]) + total(total(slope_t * way[:, 1:]))
        along = total(to * way[:, 1:], 1)
        across = to[:, 0] * way[:, 2] - to[:, 1] * way[:, 1]
        bend = nn * way[:, 0] ** 2 - 2 * nc * way[:, 0] * along + r * along**2 + q * across**2
        return slope, square + total(pushed * limit_way) + total(bend)

    zero = jnp.zeros_like(square)
    first = slopes(zero)[0]

    def unsure(carry):
        count, going, *_ = carry
        return (count < LINE_SEARCH) & going.any()

    def closer(carry):
        count, going, found, at, (low, slope_low), (high, slope_high) = carry
        slope, bend = slopes(at)
        found = jnp.where(going, at, found)
        going = going & (abs(slope) > _SLOPE_LEFT * abs(first))
        rises = slope >= 0
        low, slope_low = jnp.where(rises, low, at), jnp.where(rises, slope_low, slope)
        high, slope_high = jnp.where(rises, at, high), jnp.where(rises, slope, slope_high)
        newton = at - slope / bend
        secant = low - slope_low * (high - low) / (slope_high - slope_low)
        at = jnp.where((newton > low) & (newton < high), newton, jnp.where(high < _FAR, secant, 2 * at))
        return count + 1, going, found, at, (low, slope_low), (high, slope_high)

    start = (0, going, zero, zero + 1, (zero, first), (zero + _FAR, zero))
    return jax.lax.while_loop(unsure, closer, start)[2]


def _forces(problem: Problem, cones: _Cones, acc):
    limit, (normal, tangent) = _residuals(problem, cones, acc)
    slope_normal, slope_tangent, _ = _slopes(cones, normal, tangent)
    slope = jnp.concatenate([slope_normal[:, None], slope_tangent], 1)
    return -problem.limit_weight * jnp.minimum(limit, 0), -cones.scale * slope


def _torque(problem: Problem, limit_force, contact_force):
    return problem.limit_side * limit_force + total(total(problem.contact_jac * contact_force[:, :, None]))


def _largest(vector):
    return reduce(jnp.maximum, abs(vector))
