"""The solver of limits and contacts against SciPy on MuJoCo's cost, and against finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from mjx_fit.engines.mjx import friction_cones, newton_solver

N, CONTACTS, IMPRATIO = 24, 3, 10.0
FRICTIONS = (1e-5, 0.3, 2.0)


def rows(seed):
    """One world: M, τ, limits (side, a_ref, D), contacts (J, a_ref, D)."""
    rng = np.random.default_rng(seed)
    a = rng.normal(0, 1, (7, 9))
    mass = a @ a.T / 9 + 0.1 * np.eye(7)
    limit = rng.integers(-1, 2, 7) * (rng.random(7) < 0.3)
    jac = rng.normal(0, 0.5, (CONTACTS, 3, 7)) * (rng.random(CONTACTS) < 0.8)[:, None, None]
    reference = np.zeros((CONTACTS, 3))
    reference[:, 0] = rng.uniform(0, 60, CONTACTS)
    reference[:, 1:] = rng.normal(0, 10, (CONTACTS, 2))
    reference *= np.abs(jac).max((1, 2))[:, None] > 0
    return (
        mass,
        rng.normal(0, 20, 7),
        limit,
        20 * limit**2,
        np.full(7, 30.0),
        jac,
        reference,
        np.full(CONTACTS, 50.0),
    )


def textbook_cost(acc, mass, torque, side, limit_acc, limit_weight, jac, reference, weight, friction):
    """MuJoCo's cost, documentation's chapter Computation, contact by contact, in double precision."""
    value = 0.5 * acc @ mass @ acc - acc @ torque
    value += 0.5 * (limit_weight * np.minimum(side * acc - limit_acc, 0) ** 2).sum()
    mu = friction / np.sqrt(IMPRATIO)
    for j, ref, d in zip(jac, reference, weight, strict=True):
        normal, *tangent = j @ acc - ref
        n, t = mu * normal, friction * np.hypot(*tangent)
        if mu * n + t <= 0 and n < 0:
            value += 0.5 * (d * normal**2 + IMPRATIO * d * np.sum(np.square(tangent)))
        elif n < mu * t:
            value += 0.5 * d / (mu**2 * (1 + mu**2)) * (n - mu * t) ** 2
    return value


def problem_of(worlds, friction=0.3):
    mass, torque, side, limit_acc, limit_weight, jac, reference, weight = (
        jnp.asarray(np.stack(x, -1), jnp.float32) for x in zip(*worlds, strict=True)
    )
    b = mass.shape[-1]
    contacts = friction_cones.from_rows(jac, reference, weight, jnp.full(b, friction), jnp.full(b, IMPRATIO))
    return newton_solver.Problem(mass, torque, side, limit_acc, limit_weight, contacts)


@pytest.fixture(scope="module")
def worlds():
    return [rows(seed) for seed in range(N)]


@pytest.fixture(scope="module")
def solve():
    """The solver, begun again where it stopped, as the steps of an attempt do: these problems are hard."""
    return jax.jit(
        lambda problem, guess: newton_solver.solve(problem, newton_solver.solve(problem, guess).acc)
    )


@pytest.mark.parametrize("friction", FRICTIONS)
def test_the_minimum_is_scipys(worlds, solve, friction):
    problem = problem_of(worlds, friction)
    solution = solve(problem, jnp.zeros((7, N)))
    local = newton_solver._local(problem, solution.acc)
    # Almost without friction a gradient of some hundredths of a N·m is what float32 leaves.
    assert (~local.unsolved | (np.abs(local.gradient).max(0) < 2e-2)).all()
    for i, world in enumerate(worlds):
        best = scipy.optimize.minimize(textbook_cost, np.zeros(7), (*world, friction), method="BFGS")
        mine = textbook_cost(np.asarray(solution.acc[:, i], float), *world, friction=friction)
        assert mine <= best.fun + 1e-5 * abs(best.fun)


@pytest.mark.parametrize("friction", FRICTIONS)
def test_forces_balance_and_stay_in_their_cones(worlds, solve, friction):
    solution = jax.tree.map(np.asarray, solve(problem_of(worlds, friction), jnp.zeros((7, N))))
    for i, (mass, torque, side, *_, jac, _, _) in enumerate(worlds):
        from_contacts = np.einsum("ckj,ck->j", jac, solution.contact_force[..., i])
        from_rows = side * solution.limit_force[:, i] + from_contacts
        assert solution.torque[:, i] == pytest.approx(from_rows, abs=1e-3)
        assert mass @ solution.acc[:, i] == pytest.approx(
            torque + from_rows,
            abs=newton_solver._TOLERANCE * (np.abs(torque).max() + 2 * np.abs(from_rows).max()),
        )
        assert mass @ solution.smooth_acc[:, i] == pytest.approx(torque, abs=1e-3)
        normal, tangent = solution.contact_force[:, 0, i], solution.contact_force[:, 1:, i]
        assert (normal >= 0).all()
        assert (np.hypot(*tangent.T) <= friction * normal * 1.001 + 1e-4).all()
        assert (solution.limit_force[:, i] >= 0).all()
    assert (solution.contact_force[:, 0] > 0).mean() > 0.3


def test_no_constraint_is_free_motion(worlds, solve):
    free = [(*w[:2], np.zeros(7), np.zeros(7), w[4], 0 * w[5], 0 * w[6], w[7]) for w in worlds]
    solution = solve(problem_of(free), jnp.ones((7, N)))
    assert np.abs(solution.torque).max() == 0
    assert np.allclose(solution.acc, solution.smooth_acc, rtol=1e-3, atol=1e-3)


def test_a_world_does_not_depend_on_the_others(worlds, solve):
    """Not to the bit, even where another one is not finite or takes longer."""
    alone = solve(problem_of(worlds), jnp.zeros((7, N)))
    broken = list(worlds)
    broken[3] = (worlds[3][0], np.full(7, np.nan), *worlds[3][2:])
    broken[5] = rows(99)
    beside = solve(problem_of(broken), jnp.zeros((7, N)))
    others = np.delete(np.arange(N), [3, 5])
    for a, b in zip(alone, beside, strict=True):
        assert np.array_equal(np.asarray(a)[..., others], np.asarray(b)[..., others])
    assert np.isnan(np.asarray(beside.acc)[:, 3]).all()


def test_derivatives_are_those_of_the_cost(worlds):
    contacts = problem_of(worlds).contacts
    rng = np.random.default_rng(0)
    with jax.enable_x64(True):
        contacts = jax.tree.map(lambda x: jnp.asarray(np.asarray(x, np.float64)), contacts)
        acc, way = jnp.asarray(rng.normal(0, 30, (2, 7, N)))
        # Half of them where all contacts are pressed, so that some stick.
        pressed = contacts.reference.at[:, 0, ::2].add(40.0).at[:, 1:, ::2].multiply(0.05)
        contacts = contacts._replace(reference=pressed)

        def along(at):
            return friction_cones.cost(contacts, friction_cones.residual(contacts, acc + at * way))

        gradient, hessian_u = friction_cones.derivatives(contacts, friction_cones.residual(contacts, acc))
        v = jnp.einsum("ckjb,jb->ckb", contacts.jac, way)
        eps = 1e-5
        slope = (along(eps) - along(-eps)) / (2 * eps)
        assert np.allclose((gradient * v).sum((0, 1)), slope, rtol=1e-5, atol=1e-4)
        further, _ = friction_cones.derivatives(contacts, friction_cones.residual(contacts, acc + eps * way))
        back, _ = friction_cones.derivatives(contacts, friction_cones.residual(contacts, acc - eps * way))
        curve = ((further - back) / (2 * eps) * v).sum((0, 1))
        assert np.allclose(friction_cones.curvature(hessian_u, v).sum(0), curve, rtol=1e-4, atol=1e-3)
        hessian = friction_cones.hessian(contacts, hessian_u)
        assert np.allclose(jnp.einsum("ib,ijb,jb->b", way, hessian, way), curve, rtol=1e-4, atol=1e-3)
        slides, sticks = (
            np.asarray(x) for x in friction_cones._zones(contacts, friction_cones.residual(contacts, acc))[2:]
        )
    assert slides.any()
    assert sticks.any()
    assert (~slides & ~sticks).any()
