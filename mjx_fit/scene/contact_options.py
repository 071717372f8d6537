"""Contact of a pair of parts: friction, stiffness, and the pairs of geoms that may touch."""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

from dataclasses import replace
from itertools import product

import mujoco

from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.config.sections.shape import Shape
from mjx_fit.scene.outline import contact_width_m

PEG_BIT, HOLE_BIT = 1, 2


def touching(config: SceneConfig, pair: tuple[Shape, Shape]) -> SceneConfig:
    """Return the contact of a pair of parts: that of the smaller clearance."""
    return replace(
        config,
        steps_per_torque=config.physics_steps,
        contact_width_m=min(contact_width_m(shape, config) for shape in pair),
        contact_time_s=min(map(config.contact_time_of, pair)),
    )


def contact_options(config: SceneConfig, contype: int, conaffinity: int) -> dict:
    """Return the options of a geom."""
    return {
        "contype": contype,
        "conaffinity": conaffinity,
        "condim": 3,
        "density": 0,
        "friction": [config.friction, 0.005, 0.0001],
        "solref": [config.contact_time_s, config.contact_damping],
        "solimp": [
            config.contact_impedance,
            config.deep_impedance,
            config.contact_width_m,
            0.5,
            2.0,
        ],
    }


def add_pairs(spec: mujoco.MjSpec, config: SceneConfig, n_peg: int, n_hole: int) -> None:
    """Add all pairs of boxes explicitly: MuJoCo stores the time constant of friction with a pair only."""
    of_box = contact_options(config, PEG_BIT, HOLE_BIT)
    slide, spin, roll = of_box["friction"]
    for i, j in product(range(n_peg), range(n_hole)):
        spec.add_pair(
            geomname1=f"peg_{i}",
            geomname2=f"hole_{j}",
            condim=of_box["condim"],
            friction=[slide, slide, spin, roll, roll],
            solref=of_box["solref"],
            solimp=of_box["solimp"],
            solreffriction=[config.slip_time_s, 1.0],
        )
