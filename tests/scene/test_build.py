from dataclasses import replace
from typing import get_args

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mjx_fit as mf
from mjx_fit.config.files import read_config
from mjx_fit.config.part_sets import parts_file
from mjx_fit.config.sections.scene import RobotName, SceneConfig
from mjx_fit.config.sections.shape import SHAPES, Shape
from mjx_fit.control.kinematics import chain_of, inverse
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.engines.native.models import Models
from mjx_fit.scene import build
from mjx_fit.scene.build import pair_index, picture_scene, place_holes, simulation_scene
from mjx_fit.scene.parts import hole_boxes, peg_boxes
from mjx_fit.scene.robot import PANDA, ROBOTS
from mjx_fit.types.physics import Physics
from mjx_fit.utils.errors import RequestError

MASS = {
    "link1": 4.970684, "link2": 0.646926, "link3": 3.228604, "link4": 3.587895, "link5": 1.225946,
    "link6": 1.666555, "link7": 0.735522, "wrist": 0.30,
}  # fmt: skip


def test_arm_has_the_published_masses_and_limits(scene):
    model = scene.models[0]
    for name, mass in MASS.items():
        assert model.body(name).mass == pytest.approx(mass)
    assert model.joint("joint4").range == pytest.approx([-3.0718, -0.0698])
    assert model.actuator_ctrlrange[:, 1] == pytest.approx([87] * 4 + [12] * 3)
    assert scene.robot == PANDA
    assert PANDA.torque_limit_nm == tuple(model.actuator_ctrlrange[:, 1])
    assert PANDA.joints == tuple(model.joint(i).name for i in range(model.njnt))
    assert model.opt.timestep == 0.002


def test_the_simulated_scene_has_nothing_to_look_at(scene):
    """Every random world has a copy of its model: with textures 1.2 MB instead of some 20 kB."""
    for model in scene.models:
        assert (model.nlight, model.ncam, model.ntex) == (0, 0, 0)
        assert (model.geom_contype | model.geom_conaffinity).all()
        assert mujoco.mj_sizeModel(model) < 50_000


def test_forward_kinematics_at_home_is_the_vendors(scene):
    """At q = 0 the modified DH chain ends at x = 0.088, z = 0.333 + 0.316 + 0.384 - 0.107 (flange)."""
    model = scene.models[0]
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    assert data.body("flange").xpos == pytest.approx([0.088, 0, 0.333 + 0.316 + 0.384 - 0.107], abs=1e-6)


def test_each_model_holds_its_pair(scene):
    for peg in range(3):
        for hole in range(3):
            model = scene.models[pair_index(peg, hole, 3)]
            for name, boxes in (
                ("peg", peg_boxes(SHAPES[peg], scene.config)),
                ("hole", hole_boxes(SHAPES[hole], scene.config)),
            ):
                geoms = [model.geom(f"{name}_{i}") for i in range(len(boxes.centre))]
                assert np.allclose([geom.pos for geom in geoms], boxes.centre)
                assert np.allclose([geom.size for geom in geoms], boxes.half)


def test_spare_boxes_are_buried(scene):
    """Every box of the layout that its shape does not use lies wholly inside one that it does use."""
    spare = 0
    for model in scene.models:
        for body in ("peg", "hole"):
            geoms = [model.geom(i) for i in range(model.ngeom) if model.geom(i).name.startswith(f"{body}_")]
            big = [geom for geom in geoms if geom.size.max() > 0.0011]
            for geom in geoms:
                if geom.size.max() <= 0.0011:
                    spare += 1
                    assert any((np.abs(geom.pos - b.pos) + geom.size < b.size).all() for b in big)
    assert spare > 0


def test_only_peg_and_hole_collide(scene):
    model = scene.models[0]
    for i in range(model.ngeom):
        for j in range(i):
            collide = model.geom_contype[i] & model.geom_conaffinity[j]
            collide |= model.geom_contype[j] & model.geom_conaffinity[i]
            bodies = {model.body(model.geom_bodyid[k]).name for k in (i, j)}
            assert bool(collide) == (bodies == {"peg", "hole"})


@given(st.integers(0, 2**32 - 1), st.integers(1, 8))
def test_holes_never_overlap_and_stay_in_the_workspace(seed, n):
    config = SceneConfig()
    centres = place_holes(np.random.default_rng(seed), n, config)
    apart = np.abs(centres[:, None] - centres).max(-1) + np.eye(n)
    assert apart.min() >= 2 * config.plate_half_width_m
    (x0, x1), (y0, y1) = PANDA.workspace_m
    wider = 0.1 * (n > 6)
    assert ((centres >= [x0, y0 - wider]) & (centres <= [x1, y1 + wider])).all()


def test_picture_scene_compiles_with_every_hole_named():
    centres = place_holes(np.random.default_rng(1), 5, SceneConfig())
    model = picture_scene(SceneConfig(), [0, 1, 2, 0, 1], centres)
    assert np.allclose([model.body(f"hole{i}").pos[:2] for i in range(5)], centres)


def test_spare_boxes_stay_inside_thin_shapes():
    thin = Shape("thin", ((-0.02, -0.0005, 0.02, 0.0005),))
    step = Shape("step", ((-0.02, -0.02, 0.0, 0.02), (0.0, -0.02, 0.02, 0.019)))
    config = replace(SceneConfig(), shapes=(SHAPES[0], thin, step))
    for peg, hole in ((1, 0), (0, 2)):
        model = simulation_scene(config).models[pair_index(peg, hole, 3)]
        for name, boxes in (
            ("peg", peg_boxes(config.shapes[peg], config)),
            ("hole", hole_boxes(config.shapes[hole], config)),
        ):
            real, n = model.geom(f"{name}_{len(boxes.centre) - 1}"), len(boxes.centre)
            spare = [model.geom(i) for i in range(model.ngeom) if model.geom(i).name.startswith(f"{name}_")][
                n:
            ]
            for geom in spare:
                assert (np.abs(geom.pos - real.pos) + geom.size <= real.size + 1e-9).all()


def test_a_lopsided_peg_hangs_and_stands_as_its_hole_is():
    """In the world, in C: over the hole, in the hand and placed, its boxes are the shape's rectangles."""
    ell = Shape("ell", ((-0.020, -0.020, 0.000, 0.020), (0.000, -0.020, 0.020, 0.000)))
    config = SceneConfig(shapes=(ell, *SHAPES[1:]))
    hole = np.array([0.5, 0.1])
    low, high = np.split(np.array(ell.rectangles), 2, axis=1)
    for model, names in (
        (simulation_scene(config).models[0], ["peg_{}"]),
        (picture_scene(config, [0], hole[None]), ["hand_ell_{}", "placed_0_ell_{}"]),
    ):
        data = mujoco.MjData(model)
        tip = jnp.array([*hole, 0.2], jnp.float32)
        data.qpos[:7] = inverse(chain_of(model), tip)
        mujoco.mj_kinematics(model, data)
        for name in names:
            centres = np.array([data.geom(name.format(i)).xpos[:2] for i in range(2)])
            assert np.allclose(centres - hole, (low + high) / 2, atol=1e-4)


def test_a_placed_peg_stands_over_the_floor():
    model = picture_scene(SceneConfig(), [2], np.array([[0.5, 0.1]]))
    geom, config = model.geom("placed_0_cross_0"), SceneConfig()
    assert geom.pos[2] - geom.size[2] == pytest.approx(-config.hole_depth_m + 0.002)


def test_holes_may_stand_side_by_side():
    """Apart along one axis is apart: two boxes may share an x or a y, and often do."""
    config, beside = SceneConfig(), 0
    for seed in range(20):
        centres = place_holes(np.random.default_rng(seed), 3, config)
        gap = np.abs(centres[:, None] - centres)[np.triu_indices(3, 1)]
        beside += (gap.min(1) < 2 * config.plate_half_width_m).sum()
    assert beside > 10


def test_a_configuration_names_every_robot():
    assert get_args(RobotName) == tuple(ROBOTS)


NIST = read_config(parts_file("nist"))


def test_stiffness_and_step_follow_the_smaller_clearance():
    scene = simulation_scene(NIST.scene)
    gaps = np.array([NIST.scene.clearance_of(shape) for shape in NIST.scene.shapes])
    for pair, model in enumerate(scene.models):
        gap = gaps[list(divmod(pair, len(gaps)))].min()
        np.testing.assert_allclose(model.pair_solref[:, 0], NIST.scene.contact_time_per_gap * gap)
        np.testing.assert_allclose(model.pair_solimp[:, 2], 0.1 * gap)
        assert model.pair_solref[0, 0] >= 2 * model.opt.timestep
        assert model.opt.timestep * NIST.scene.physics_steps == pytest.approx(0.002)
    softer = Models(scene).of(np.array([0]), Physics(contact_time_s=np.array([0.01])))[0]
    stiffer = Models(scene).of(np.array([0]), Physics(contact_time_s=np.array([0.0008])))[0]
    assert softer.pair_solref[0, 0] == pytest.approx(NIST.scene.contact_time_per_gap * gaps[0])
    assert stiffer.pair_solref[0, 0] == pytest.approx(0.0008)


def test_a_contact_time_below_the_shortest_is_refused():
    with pytest.raises(RequestError, match=r"contact_time_per_gap: 9\.0 is out of range: expected 9\.09"):
        read_config(parts_file("nist"), ["scene.contact_time_per_gap=9"])
    assert simulation_scene(read_config(parts_file("nist"), ["scene.contact_time_per_gap=9.1"]).scene)


def test_a_longer_contact_time_per_gap_needs_fewer_steps():
    config = read_config(parts_file("nist"), ["scene.contact_time_per_gap=20"])
    assert (NIST.scene.physics_steps, config.scene.physics_steps) == (8, 4)
    square = config.scene.names.index("square_4")
    assert config.scene.contact_time_of(config.scene.shapes[square]) == pytest.approx(0.0011)


def test_parts_of_any_kind_share_a_batch():
    """MuJoCo's batch takes models of one layout, and meshes differ."""
    chosen = [shape for shape in NIST.scene.shapes if shape.name in ("round_4", "square_4", "d_sub")]
    task = replace(NIST.task, success_probability=None, success_by_error=None)
    config = replace(NIST, scene=replace(NIST.scene, shapes=tuple(chosen)), task=task)
    done = NativeEngine(config, 2).run(mf.draw_attempts(jax.random.key(0), 9, config=config), 3)
    assert done.truth.valid.all()
    assert (done.felt.length == 3).all()


@pytest.mark.parametrize("missing", [1, 2, 3, 4, 64])
def test_models_are_made_alike_whatever_they_lack(missing):
    """Odd and even numbers of nodes; the names of the meshes that add them must differ."""
    small, large = mujoco.MjSpec(), mujoco.MjSpec()
    for spec in (small, large):
        spec.worldbody.add_body().add_geom(size=[0.1, 0, 0])
    for number, nodes in enumerate((missing,) if missing % 2 else (1, missing - 1)):
        build._add_unused_mesh(large, f"own_{number}", (nodes + 1) // 2)
    one, other = build._alike([small, large])
    assert one.nbvh == other.nbvh == small.compile().nbvh
    assert one.nmesh > 0
