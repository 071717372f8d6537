"""Sections of solids: STL and OBJ by trimesh, STEP by trimesh and cascadio."""

from pathlib import Path

import numpy as np
import shapely
from shapely import MultiPolygon

from mjx_fit.utils.errors import RequestError

AXES = ("x", "y", "z", "-x", "-y", "-z")
"""Directions in which a part may be inserted, in the frame of its file."""
MESHES, STEP = (".stl", ".obj"), (".step", ".stp")
HEIGHTS = 9
"""Number of sections that are compared over the insertion depth."""


class Solid:
    """Solid whose sections across the direction of insertion are wanted, in units of its file."""

    def __init__(self, path: Path, axis: str, tolerance: float):
        """Read a file.

        Args:
            path: The file.
            axis: Direction of insertion, one of ``AXES``.
            tolerance: Largest distance of a facet of a STEP file from its surface.

        Raises:
            RequestError: The file cannot be read, or its surface is not closed.
        """
        import trimesh

        self._path = path
        try:
            is_step = path.suffix.lower() in STEP
            mesh = _step(path, tolerance) if is_step else trimesh.load_mesh(path)
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
            raise RequestError(f"{self._path}: cannot be used: there is no section at {at:g}")
        flat, _ = cut.to_2D(to_2D=self._seen_from_behind())
        parts = [shapely.orient_polygons(part) for part in flat.polygons_full]
        if not parts:
            raise RequestError(f"{self._path}: cannot be used: the section at {at:g} is not closed")
        return MultiPolygon(parts)

    def largest_change(self, at: float, depth: float) -> float:
        """Return how far sections over a depth from the tip are from the one at a distance, at most."""
        here = self.section(at)
        others = (self.section(depth * (i + 0.5) / HEIGHTS) for i in range(HEIGHTS))
        return max(float(shapely.hausdorff_distance(here.boundary, other.boundary, 0.05)) for other in others)

    def _seen_from_behind(self) -> np.ndarray:
        """Return the transform to the plane of a section, whose normal points against the insertion."""
        normal = -self._towards
        x = np.eye(3)[(int(np.argmax(abs(normal))) + 1) % 3]
        frame = np.eye(4)
        frame[:3, :3] = np.stack([x, np.cross(normal, x), normal])
        return frame


def _step(path: Path, tolerance: float):
    """Read a STEP file by the optional reader, in its own units."""
    import trimesh

    try:
        import cascadio
    except ImportError:
        raise RequestError(
            f"{path}: STEP needs an extra package: pip install 'mjx-fit[step]', or convert the file to STL"
        ) from None
    content = cascadio.load(path.read_bytes(), file_type="step", tol_linear=tolerance, tol_relative=False)
    mesh = trimesh.load_scene(trimesh.util.wrap_as_stream(content), file_type="glb").to_mesh()
    mesh.apply_scale(1000.0)  # the reader gives metres, STEP files are in millimetres
    mesh.merge_vertices()
    return mesh
