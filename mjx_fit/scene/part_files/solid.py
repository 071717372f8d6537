"""Sections of solids: STL and OBJ by trimesh, STEP by trimesh and cascadio."""

from pathlib import Path

import numpy as np
import shapely
from shapely import MultiPolygon

from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.streams import native_output_silenced

AXES = ("x", "y", "z", "-x", "-y", "-z")
"""Directions in which a part may be inserted, in the frame of its file."""
MESHES, STEP = (".stl", ".obj"), (".step", ".stp")
_LEAST_STEP_M = 1e-6
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
        self._mesh = mesh
        self._towards = (-1.0 if axis.startswith("-") else 1.0) * np.eye(3)["xyz".index(axis[-1])]
        along = mesh.vertices @ self._towards
        self.length, self._tip = float(np.ptp(along)), float(along.max())

    def section(self, at: float) -> MultiPolygon:
        """Return the section at a distance from the end that is inserted first, seen against the insertion.

        Raises:
            RequestError: There is no section.
        """
        cut = self._mesh.section(plane_origin=(self._tip - at) * self._towards, plane_normal=-self._towards)
        if cut is None:
            raise RequestError(f"{self._path}: cannot be used: there is no section at {1000 * at:g} mm")
        flat, _ = cut.to_2D(to_2D=self._seen_from_behind())
        figure = shapely.build_area(
            shapely.MultiLineString([line for line in flat.discrete if len(line) > 1])
        )
        if figure.is_empty:
            raise RequestError(f"{self._path}: cannot be used: the section at {1000 * at:g} mm is not closed")
        return MultiPolygon([shapely.orient_polygons(part) for part in getattr(figure, "geoms", [figure])])

    def largest_change(self, at: float, start: float, end: float) -> float:
        """Return how far sections between two distances from the tip are from the one at a distance, at most.

        A section is taken between each two neighbouring heights at which the surface has corners.
        """
        heights = self._tip - self._mesh.vertices @ self._towards
        inside = heights[(heights > start) & (heights < end)]
        levels = np.unique(np.concatenate([[start, end], inside.round(7)]))
        middles = (levels[1:] + levels[:-1])[np.diff(levels) > _LEAST_STEP_M] / 2
        middles = middles[np.linspace(0, len(middles) - 1, min(len(middles), MOST_SECTIONS)).astype(int)]
        here = self.section(at)
        return max(
            float(shapely.hausdorff_distance(here.boundary, self.section(float(one)).boundary, 0.05))
            for one in middles
        )

    def _seen_from_behind(self) -> np.ndarray:
        """Return the transform to the plane of a section, whose normal points against the insertion."""
        normal = -self._towards
        x = np.eye(3)[(int(np.argmax(abs(normal))) + 1) % 3]
        frame = np.eye(4)
        frame[:3, :3] = np.stack([x, np.cross(normal, x), normal])
        return frame


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
