"""Move of the centre of pressure by a tilt of the tool that the robot takes for straight down.

A square peg slides on its socket far from the hole. A stiff controller presses it on one edge; one with a
dead zone of its torque lets it align itself.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import shared

from mjx_fit.data.schedule import draw_attempts
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.sensors.force_torque import centre_of_pressure
from mjx_fit.types.physics import Physics

N, ACTIONS, FIRST = 12, 20, 5
"""Attempts, their actions, and the first action that counts: the peg has touched down."""
TILTS_DEG, DEAD_ZONES_NM = (0.0, 0.02, 0.05, 0.1, 0.2, 0.5), (0.0, 0.5)
BESIDE_M = 0.045
"""Distance from the hole, m: more than the peg reaches."""


def main() -> None:
    """Measure every tilt about the world's y, under each dead zone."""
    config = shared.config()
    engine = NativeEngine(config, 2)
    square = np.full(N, config.scene.names.index("square"))
    drawn = draw_attempts(jax.random.key(3), jnp.arange(N), "spiral", config)
    beside = np.asarray(drawn.hole_pos_world) + np.array([BESIDE_M, 0], np.float32)
    attempts = replace(drawn, peg_type=square, hole_type=square, estimate_world=beside)
    rows = []
    for dead_zone_nm in DEAD_ZONES_NM:
        for degrees in TILTS_DEG:
            own = {"tilt_y_rad": np.deg2rad(degrees), "dead_zone_nm": dead_zone_nm}
            physics = Physics(**{name: np.full(N, value, np.float32) for name, value in own.items()})
            felt = engine.run(replace(attempts, physics=physics), ACTIONS, horizon=100 * ACTIONS).felt
            wrench = felt.trace.wrench_sensor - felt.tare_sensor[:, None, None]
            place = centre_of_pressure(jnp.asarray(wrench[:, FIRST:].mean(2)), config.scene.peg_length_m)
            along_mm = 1000 * np.asarray(place)[..., 0]
            rows.append(
                {
                    "tilt_deg": degrees,
                    "dead_zone_nm": dead_zone_nm,
                    "pressure_x_mm": float(along_mm.mean()),
                    "std_mm": float(along_mm.std()),
                }
            )
            print(rows[-1])
    shared.save("tilt", {"n": N, "rows": rows})


if __name__ == "__main__":
    shared.begin()
    main()
