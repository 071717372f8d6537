"""Geometry of 26 parts: sections, facets, gaps and convex pieces, against exact sections by shapely.

    python experiments/parts/table.py

Parts are the paper's, NIST's, the set ``shafts`` and those of the files in this folder. Facets and areas are
compared with the same section at a thousandth of the tolerance, those from files with the same file at a
25th. Writes ``table.json`` and pictures.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely import MultiPolygon, Polygon

from mjx_fit.config.files import read_config
from mjx_fit.config.part_sets import parts_file
from mjx_fit.config.schema import Config
from mjx_fit.config.sections.cross_section import CrossSection
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.config.sections.shape import Shape
from mjx_fit.report import script
from mjx_fit.report.figures.parts import parts as draw_parts
from mjx_fit.scene.decomposition import convex_pieces
from mjx_fit.scene.outline import facet_tolerance_m, hole_outline, outline, peg_outline, rings_of
from mjx_fit.scene.part_files.importing import Wanted, import_part
from mjx_fit.scene.pieces import peg_pieces, socket_pieces

HERE = Path(__file__).parent
FILES = {
    "slot": "slot.dxf",
    "gear": "gear.svg",
    "wedge": "wedge.stl",
    "flat_shaft": "d_shaft.step",
    "plug": "usb.step",
}
FILE_CLEARANCE_M, FILE_TOLERANCE_M = 0.0001, 5e-6
SAMPLES, FINER, FINER_FILE = 20_000, 0.001, 0.04
CORNER_RAD = 0.3
"""Corners that turn by more than this keep a mitre, whose gap is wider than the clearance."""


def main() -> None:
    rows = {}
    for name, scene in scenes().items():
        for shape in scene.shapes:
            rows[shape.name] = {"set": name, **measured(shape, scene)}
            print(shape.name, rows[shape.name], flush=True)
        script.draw(HERE / f"{name}.png", lambda scene=scene: draw_parts(scene))
    script.save(HERE / "table.json", rows)


def scenes() -> dict[str, SceneConfig]:
    """Return the scenes of all parts, by name of the set."""
    found = {name: read_config(parts_file(name)).scene for name in ("paper", "nist", "shafts")}
    files = tuple(
        Shape(name, section=from_file(name, FILE_TOLERANCE_M), clearance_m=FILE_CLEARANCE_M) for name in FILES
    )
    return found | {"files": replace(Config().scene, shapes=files)}


def from_file(name: str, tolerance_m: float) -> CrossSection:
    """Return the section of a sample file."""
    return import_part(HERE / FILES[name], Wanted(tolerance_m=tolerance_m)).section


def exact_outline(shape: Shape, scene: SceneConfig, tolerance_m: float) -> MultiPolygon:
    """Return the outline of a part with much finer facets."""
    if shape.section is None:
        return peg_outline(shape, scene)
    if shape.name in FILES:
        return outline(from_file(shape.name, FINER_FILE * FILE_TOLERANCE_M), FINER * tolerance_m)
    return outline(shape.section, FINER * tolerance_m)


def measured(shape: Shape, scene: SceneConfig) -> dict[str, Any]:
    """Return areas, errors of facets and gaps over the clearance, and numbers of pieces."""
    peg, hole, gap = peg_outline(shape, scene), hole_outline(shape, scene), scene.clearance_of(shape)
    tolerance_m = facet_tolerance_m(shape, scene)
    exact = exact_outline(shape, scene, tolerance_m)
    pieces = [Polygon(corners) for corners in convex_pieces(peg)]
    points = sampled(peg)
    gaps = np.asarray(shapely.distance(points, hole.boundary)) / gap
    straight = np.asarray(shapely.distance(points, corners(peg))) > 3 * gap
    return {
        "corners": int(shapely.get_num_coordinates(peg)),
        "area_mm2": 1e6 * peg.area,
        "area_of_pieces_over_section": sum(piece.area for piece in pieces) / peg.area,
        "overlap_of_pieces_over_section": 1
        - shapely.union_all(pieces).area / sum(piece.area for piece in pieces),
        "facet_error_um": 1e6 * float(shapely.hausdorff_distance(peg.boundary, exact.boundary, 0.01)),
        "facet_tolerance_um": 1e6 * tolerance_m,
        "gap_over_clearance": [float(gaps.min()), float(gaps[straight].max())],
        "own_socket": shape.socket.section is not None,
        "pieces_peg": len(peg_pieces(shape, scene)),
        "pieces_socket": len(socket_pieces(shape, scene)),
    }


def sampled(figure: MultiPolygon) -> np.ndarray:
    """Return points on the boundary, evenly spaced."""
    return shapely.line_interpolate_point(figure.boundary, np.linspace(0, 1, SAMPLES), normalized=True)


def corners(figure: MultiPolygon) -> shapely.MultiPoint:
    """Return the corners at which the boundary turns sharply."""
    found = []
    for ring in rings_of(figure):
        points = np.asarray(ring.coords)[:-1] @ [1, 1j]
        turn = np.angle((np.roll(points, -1) - points) / (points - np.roll(points, 1)))
        found += [(point.real, point.imag) for point in points[abs(turn) > CORNER_RAD]]
    return shapely.MultiPoint(found or [(1.0, 1.0)])


if __name__ == "__main__":
    main()
