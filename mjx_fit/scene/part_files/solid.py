"""Sections of solids: STL and OBJ by trimesh, STEP by trimesh and cascadio."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import shapely
from shapely import MultiPolygon
from shapely.geometry.base import BaseGeometry

from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.streams import native_output_silenced

if TYPE_CHECKING:
    import trimesh

AXES = ("x", "y", "z", "-x", "-y", "-z")
"""Directions in which a part may be inserted, in the frame of its file."""
MESHES, STEP = (".stl", ".obj"), (".step", ".stp")
_UM = 1e-6
"""Unit in which bodies are cut, m: trimesh leaves out corners that are 1e-4 units apart."""
_INSIDE_M = 1e-6
_NO_VOLUME = 1e-9
MOST_SECTIONS = 200
"""Most sections that are compared over the insertion depth."""


class Solid:
    """Solid whose sections across the direction of insertion are wanted, in m."""

    def __init__(self, path: Path, axis: str, tolerance_m: float, unit_m: float):
        """Read a file.

        Args:
            path: The file.
            axis: Direction of insertion, one of ``AXES``.
            tolerance_m: Largest distance of a facet of a STEP file from its surface, m.
            unit_m: Unit of meshes, m; a STEP file states its own.

        Raises:
            RequestError: The file cannot be read, or its surface is not closed.
        """
        import trimesh

        self._path = path
        try:
            is_step = path.suffix.lower() in STEP
            mesh = _step(path, tolerance_m) if is_step else trimesh.load_mesh(path).apply_scale(unit_m)
        except (OSError, ValueError, IndexError, KeyError, TypeError) as error:
            raise RequestError(f"{path}: cannot be read: {error}") from None
        if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
            raise RequestError(f"{path}: cannot be used: it holds no surface")
        if not mesh.is_watertight:
            raise RequestError(f"{path}: cannot be used: its surface is not closed")
        self._towards = (-1.0 if axis.startswith("-") else 1.0) * np.eye(3)["xyz".index(axis[-1])]
        self._vertices = mesh.vertices
        along = self._vertices @ self._towards
        with np.errstate(invalid="ignore"):  # of a sheet, trimesh computes a centre of mass as well
            encloses = mesh.volume != 0
        if not encloses:
            raise RequestError(f"{path}: cannot be used: its surface encloses nothing")
        self._outer, self._cavities = _bodies(mesh.copy().apply_scale(1 / _UM))
        self.length, self._tip = float(np.ptp(along)), float(along.max())

    def section(self, at: float) -> MultiPolygon:
        """Return the section at a distance from the end that is inserted first, seen against the insertion.

        Raises:
            RequestError: There is no section.
        """
        solid, empty = (
            shapely.union_all([self._cut(body, at) for body in bodies])
            for bodies in (self._outer, self._cavities)
        )
        figure = solid.difference(empty)
        if figure.is_empty:
            raise RequestError(f"{self._path}: cannot be used: there is no section at {1000 * at:g} mm")
        return MultiPolygon([shapely.orient_polygons(part) for part in getattr(figure, "geoms", [figure])])

    def _cut(self, body: "trimesh.Trimesh", at: float) -> BaseGeometry:
        """Return the section of a single body, which may be empty."""
        origin = (self._tip - at) / _UM * self._towards
        cut = body.section(plane_origin=origin, plane_normal=-self._towards)
        if cut is None:
            return MultiPolygon()
        flat, _ = cut.to_2D(to_2D=self._seen_from_behind())
        lines = [_UM * line for line in flat.discrete if len(line) > 1]
        figure = shapely.build_area(shapely.MultiLineString(lines))
        if figure.is_empty:
            raise RequestError(f"{self._path}: cannot be used: the section at {1000 * at:g} mm is not closed")
        return figure

    def largest_change(self, at: float, start: float, end: float) -> float:
        """Return how far sections between two distances from the tip are from the one at a distance, at most.

        Between neighbouring heights at which the surface has corners, a section changes steadily: it is taken
        just inside of both ends.
        """
        heights = self._tip - self._vertices @ self._towards
        inside = heights[(heights > start) & (heights < end)]
        levels = np.unique(np.concatenate([[start, end], inside.round(7)]))
        low, high = levels[:-1], levels[1:]
        wide = high - low > 3 * _INSIDE_M
        cuts = np.concatenate([[start, *low[wide]], [*high[wide] - 2 * _INSIDE_M, end - 2 * _INSIDE_M]])
        cuts = np.unique(cuts) + _INSIDE_M
        cuts = cuts[np.linspace(0, len(cuts) - 1, min(len(cuts), MOST_SECTIONS)).astype(int)]
        here = self.section(at)
        return max(
            float(shapely.hausdorff_distance(here.boundary, self.section(float(one)).boundary, 0.05))
            for one in cuts
        )

    def _seen_from_behind(self) -> np.ndarray:
        """Return the transform to the plane of a section, whose normal points against the insertion."""
        normal = -self._towards
        x = np.eye(3)[(int(np.argmax(abs(normal))) + 1) % 3]
        frame = np.eye(4)
        frame[:3, :3] = np.stack([x, np.cross(normal, x), normal])
        return frame


def _bodies(mesh: "trimesh.Trimesh") -> tuple[list["trimesh.Trimesh"], list["trimesh.Trimesh"]]:
    """Divide a mesh into closed bodies: those that are solid, and cavities, whose surfaces point inwards."""
    bodies = list(mesh.split(only_watertight=False))
    if not all(body.is_watertight for body in bodies):  # bodies that touch along their edges
        return [mesh], []
    largest = max((body.volume for body in bodies), key=abs)
    share = [body.volume / largest for body in bodies]  # some files have all surfaces inside out
    return (
        [body for body, one in zip(bodies, share, strict=True) if one > _NO_VOLUME],
        [body for body, one in zip(bodies, share, strict=True) if one < -_NO_VOLUME],
    )


def _step(path: Path, tolerance_m: float):
    """Read a STEP file by the optional reader, which converts its units to metres."""
    import trimesh

    try:
        import cascadio
    except ImportError:
        raise RequestError(
            f"{path}: STEP needs an extra package: pip install 'mjx-fit[step]', or convert the file to STL"
        ) from None
    with native_output_silenced():  # the reader's own words about a bad file
        content = cascadio.load(
            path.read_bytes(), file_type="step", tol_linear=1000 * tolerance_m, tol_relative=False
        )
    if not content:
        raise ValueError("it holds no solid")
    scene = trimesh.load_scene(trimesh.util.wrap_as_stream(content), file_type="glb")
    if not scene.geometry:
        raise ValueError("it holds no solid")
    mesh = scene.to_mesh()
    mesh.merge_vertices()
    return mesh
