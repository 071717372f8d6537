"""Make the sample files of this folder: drawings by ezdxf and hand, solids by trimesh and Open CASCADE.

pip install gmsh        # writes STEP; no dependency of this project
python experiments/parts/make_samples.py
"""

from pathlib import Path

import ezdxf
import numpy as np
import trimesh

HERE = Path(__file__).parent
MM = 4
"""Code of millimetres in DXF."""


def main() -> None:
    slot_with_hole(HERE / "slot.dxf")
    latch(HERE / "latch.dxf")
    gear(HERE / "gear.svg")
    wedge(HERE / "wedge.stl")
    solids(HERE / "d_shaft.step", HERE / "usb.step")


def slot_with_hole(path: Path) -> None:
    """Draw a slot of 20 by 10 mm with round ends and a hole of 4 mm."""
    document = ezdxf.new(units=MM)
    space = document.modelspace()
    space.add_lwpolyline([(-5, -5, 0, 0, 0), (5, -5, 0, 0, 1), (5, 5, 0, 0, 0), (-5, 5, 0, 0, 1)], close=True)
    space.add_circle((0, 0), 2)
    document.saveas(path)


def latch(path: Path) -> None:
    """Draw a T of 16 by 12 mm with one rounded end."""
    document = ezdxf.new(units=MM)
    corners = [
        (-8, -6, 0),
        (-3, -6, 0),
        (-3, -2.5, 0),
        (8, -2.5, 1),
        (8, 2.5, 0),
        (-3, 2.5, 0),
        (-3, 6, 0),
        (-8, 6, 0),
    ]
    document.modelspace().add_lwpolyline([(x, y, 0, 0, bulge) for x, y, bulge in corners], close=True)
    document.saveas(path)


def gear(path: Path, teeth: int = 8) -> None:
    """Draw a gear of 20 mm with straight flanks, in millimetres."""
    angle = 2 * np.pi * (np.arange(4 * teeth) + 0.5) / (4 * teeth)
    radius = np.where(np.arange(4 * teeth) % 4 < 2, 10.0, 7.5)
    corners = " ".join(
        f"{x:.4f},{y:.4f}" for x, y in zip(radius * np.cos(angle), radius * np.sin(angle), strict=True)
    )
    path.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="24mm" height="24mm" viewBox="-12 -12 24 24">\n'
        f'  <polygon points="{corners}"/>\n</svg>\n'
    )


def wedge(path: Path) -> None:
    """Extrude a right triangle of 18 by 12 mm over 30 mm."""
    corners = np.array([[0, 0], [18, 0], [0, 12]])
    vertices = np.array([[*corner, height] for height in (0.0, 30.0) for corner in corners])
    trimesh.convex.convex_hull(vertices).export(path)


def solids(d_shaft: Path, usb: Path) -> None:
    """Make a shaft of 8 mm with a flat, and a plug's nose of 12 by 4.5 mm with a housing behind it."""
    import gmsh  # pyright: ignore[reportMissingImports]  # made once, not a dependency

    gmsh.initialize()
    cad = gmsh.model.occ
    shaft, flat = cad.addCylinder(0, 0, 0, 0, 0, 20, 4), cad.addBox(-5, 3, -1, 10, 5, 30)
    cad.cut([(3, shaft)], [(3, flat)])
    cad.synchronize()
    gmsh.write(str(d_shaft))
    gmsh.clear()
    nose = cad.addBox(-6, -2.25, 0, 12, 4.5, 12)
    cad.synchronize()
    boxes = {edge: gmsh.model.getBoundingBox(1, edge) for _, edge in gmsh.model.getEntities(1)}
    cad.fillet([nose], [edge for edge, box in boxes.items() if box[5] - box[2] > 11], [0.5])
    cad.fuse([(3, nose)], [(3, cad.addBox(-7, -3, 12, 14, 6, 8))])
    cad.synchronize()
    gmsh.write(str(usb))
    gmsh.finalize()


if __name__ == "__main__":
    main()
