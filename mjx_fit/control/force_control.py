"""Force of the arm on the TCP where a push is a force instead of a displacement (``ControlConfig.push``).

    F_z  = f (u_z / 4 mm - v_z / v₀)                                    f: press_n, v₀: press_speed_mps
    F_xy = limited(Λxy kp e, slide_n) - Λxy 2 ζ √kp v_xy,   Λxy = (Jxy M⁻¹ Jxyᵀ)⁻¹

At rest on a socket, a command of 4 mm down presses with f, whatever the stiffness of arm and contact. In free
space it moves the TCP at v₀: damping by f / v₀ alone can neither oscillate nor store energy, which a position
loop that an edge holds back does. The lateral spring pulls with at most ``slide_n``, so a peg that an edge
stops is not driven into it. Λxy is the lateral inertia with z free to move.
"""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Float

from mjx_fit.types import Array
from mjx_fit.utils.linalg import CholeskyFactor, cholesky_solve

FULL_PUSH_M = 0.004
"""Command that presses with ``control.press_n``, m: the push of the paper's spiral."""
_LEAST_N = 1e-6


def position_force(
    error: Float[Array, "3 *b"],
    velocity: Float[Array, "3 *b"],
    root: CholeskyFactor,
    lateral: tuple[Any, Any],
    press: tuple[float, float, float],
) -> Float[Array, "3 *b"]:
    """Compute the force on the TCP, N.

    Args:
        error: Lateral distances to the goal, m, over the vertical command u_z, m.
        velocity: Velocity of the TCP, m/s.
        root: Cholesky factor of the inverse inertia of the position, 1/kg.
        lateral: Stiffness kp (1/s²) and damping 2 ζ √kp (1/s) over inertia.
        press: ``press_n``, ``press_speed_mps`` and ``slide_n``.
    """
    stiffness, damping = lateral
    press_n, speed_mps, slide_n = press
    plane = CholeskyFactor(root.lower[:2], root.inverse_diagonal[:2])
    pull = cholesky_solve(plane, stiffness * error[:2])
    size = jnp.sqrt(jnp.square(pull).sum(0) + _LEAST_N**2)
    pull = pull * jnp.minimum(1, slide_n / size)
    drag = cholesky_solve(plane, damping * velocity[:2])
    vertical = press_n * (error[2] / FULL_PUSH_M - velocity[2] / speed_mps)
    return jnp.concatenate([pull - drag, vertical[None]])
