"""Screen in a browser, with viser."""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

import time
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import trimesh
import viser

from mjx_fit.viz.belief_marks import Mark
from mjx_fit.viz.scene_model import Puppet
from mjx_fit.viz.timeline import Moment
from mjx_fit.viz.viser_access import Door

CAMERA_M, LOOK_AT_M = (1.20, -0.67, 0.85), (0.42, 0.05, 0.14)
PANEL_EVERY_S = 0.15
"""Shortest time between panel images, in s; an image needs more bandwidth than a pose."""


class Browser:
    """Page with the scene and the panel next to it, open until the process ends."""

    def __init__(self, puppet: Puppet, door: Door):
        self._puppet = puppet
        with door.guarding():
            self._server = viser.ViserServer(host=door.host, port=door.port, verbose=False)
        self._server.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        self._server.scene.add_grid("/table", 2.0, 2.0, cell_size=0.1, plane_opacity=0.0)
        self._server.initial_camera.position = CAMERA_M
        self._server.initial_camera.look_at = LOOK_AT_M
        self._panel = self._server.gui.add_image(np.zeros((720, 460, 3), np.uint8), format="jpeg")
        self._panel_at = 0.0
        self._geoms = {i: self._add_geom(i) for i in range(puppet.model.ngeom) if _mesh(puppet.model, i)}
        self._marks: dict[int, Any] = {}
        print(f"watch at {door.address}; press Ctrl-C to stop", flush=True)

    def show(
        self, pose: Callable[[], None], moment: Moment, words: list[tuple[str, str]], panel: np.ndarray
    ) -> None:
        """Implement ``mjx_fit.viz.viewer.Screen``."""
        pose()
        data, model = self._puppet.data, self._puppet.model
        with self._server.atomic():
            for i, handle in self._geoms.items():
                handle.position, handle.wxyz = data.geom_xpos[i], _quaternion(data.geom_xmat[i])
                handle.visible = bool(model.geom_matid[i] >= 0 or model.geom_rgba[i, 3] > 0)
            self._show_marks(self._puppet.marks(moment))
        if time.monotonic() - self._panel_at > PANEL_EVERY_S or moment.phase == "learn":
            self._panel.image, self._panel_at = panel, time.monotonic()

    def is_open(self) -> bool:
        """Implement ``mjx_fit.viz.viewer.Screen``."""
        return True

    def _show_marks(self, marks: list[Mark]) -> None:
        for number, mark in enumerate(marks):
            if number not in self._marks:
                self._marks[number] = self._server.scene.add_icosphere(
                    f"/marks/{number}", opacity=mark.rgba[3]
                )
            handle = self._marks[number]
            handle.scale = tuple(np.where(mark.size > 0, mark.size, mark.size[0]))
            handle.position, handle.wxyz = mark.centre_world, _quaternion(mark.frame_world.ravel())
            handle.color = tuple(round(255 * channel) for channel in mark.rgba[:3])
            handle.visible = True
        for number in range(len(marks), len(self._marks)):
            self._marks[number].visible = False

    def _add_geom(self, i: int) -> Any:
        model = self._puppet.model
        mesh = _mesh(model, i)
        assert mesh is not None
        rgba = model.mat_rgba[model.geom_matid[i]] if model.geom_matid[i] >= 0 else model.geom_rgba[i]
        red, green, blue = (round(255 * float(channel)) for channel in rgba[:3])
        return self._server.scene.add_mesh_simple(
            f"/geoms/{i}",
            np.asarray(mesh.vertices),
            np.asarray(mesh.faces),
            color=(red, green, blue),
            flat_shading=bool(model.geom_type[i] == mujoco.mjtGeom.mjGEOM_BOX),
        )


def _mesh(model: mujoco.MjModel, i: int) -> trimesh.Trimesh | None:
    """Return the surface of a geom; None for planes, such as the table."""
    size = model.geom_size[i]
    kind = model.geom_type[i]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return trimesh.creation.box(2 * size)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return trimesh.creation.cylinder(size[0], 2 * size[1])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        capsule = trimesh.creation.capsule(2 * size[1], size[0])
        return capsule.apply_translation(-capsule.bounds.mean(0))
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return trimesh.creation.icosphere(radius=size[0])
    return None


def _quaternion(matrix: np.ndarray) -> np.ndarray:
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.asarray(matrix, float))
    return quaternion
