"""Commands ``part import`` and ``part show``: parts from files, and pictures of parts."""

import argparse

from mjx_fit.cli.options import add_command
from mjx_fit.cli.path_argument import path
from mjx_fit.config.part_sets import PART_SETS, parts_file

# Each command imports its own dependencies, so that `mjx-fit --help` answers immediately.
_MM_PER_M = 1000.0


def add_part(parsers: argparse._SubParsersAction) -> None:
    """Add ``part import`` and ``part show``."""
    whats = parsers.add_parser("part", help="import parts from files, and draw parts").add_subparsers(
        required=True, metavar="WHAT"
    )
    read = add_command(whats, "import", part_import, "make a part from a drawing or a solid")
    read.add_argument("file", type=path, metavar="FILE", help=".dxf, .svg, .stl, .obj, .step")
    read.add_argument("--units", required=True, metavar="U", help="mm, cm, m, in or um")
    read.add_argument("--name", required=True, metavar="NAME", help="name of the part")
    read.add_argument(
        "--out", type=path, required=True, metavar="FILE.yaml", help="new, or with other imported parts"
    )
    read.add_argument(
        "--axis", default="-z", metavar="A", help="direction of insertion of a solid (default -z)"
    )
    read.add_argument(
        "--at", type=float, metavar="D", help="distance of the section from a solid's tip, in --units"
    )
    read.add_argument(
        "--depth", type=float, default=10, metavar="MM", help="insertion depth in mm (default 10)"
    )
    read.add_argument(
        "--clearance", type=float, default=0.1, metavar="MM", help="air per side in mm (default 0.1)"
    )
    read.add_argument(
        "--tolerance",
        type=float,
        metavar="MM",
        help="error of straight lines (default: a 20th of the clearance)",
    )
    show = add_command(
        whats, "show", part_show, "draw parts in their sockets, and say which peg fits which socket"
    )
    show.add_argument(
        "parts", metavar="FILE|PRESET", help=f"YAML with scene.shapes, or {', '.join(PART_SETS)}"
    )
    show.add_argument("--out", type=path, metavar="FILE.png", help="picture (default: NAME.png)")


def part_import(args: argparse.Namespace) -> None:
    """Run ``part import``."""
    from mjx_fit.config.schema import config_from_tree
    from mjx_fit.report.figures.parts import parts
    from mjx_fit.report.script import draw
    from mjx_fit.scene.part_files.importing import import_part, shape_tree, wanted_of
    from mjx_fit.scene.part_files.parts_yaml import as_yaml, with_part
    from mjx_fit.scene.part_rules import require_possible
    from mjx_fit.utils.files import require_writable, write_text

    wanted = wanted_of(args.units, args.axis, args.at, args.depth, args.clearance, args.tolerance)
    require_writable(args.out)
    found = import_part(args.file, wanted)
    tree = with_part(args.out, shape_tree(args.name, found, args.clearance))
    config = config_from_tree(tree)
    require_possible(config.scene.shapes[-1], config.scene)
    write_text(args.out, as_yaml(tree))
    draw(args.out.with_suffix(".png"), lambda: parts(config.scene))
    x, y = (_MM_PER_M * side for side in found.size_m)
    print(
        f"{args.name}: {x:.4g} by {y:.4g} mm, {found.area_m2 * _MM_PER_M**2:.5g} mm², {found.corners} corners"
    )
    print(f"straight lines err by at most {_MM_PER_M * wanted.tolerance_m:.3g} mm")
    if found.change_m is not None:
        print(f"the section changes by {_MM_PER_M * found.change_m:.3f} mm over {args.depth:g} mm")
    print(args.out)


def part_show(args: argparse.Namespace) -> None:
    """Run ``part show``."""
    from pathlib import Path

    from mjx_fit.config.files import read_config
    from mjx_fit.report.figures.parts import fit_table, parts
    from mjx_fit.report.script import draw
    from mjx_fit.scene.fits import fitting
    from mjx_fit.scene.part_rules import require_possible

    scene = read_config(parts_file(args.parts)).scene
    for shape in scene.shapes:
        require_possible(shape, scene)
    fixed, turned = fitting(scene), fitting(scene, turned=True)
    out = args.out or Path(f"{Path(args.parts).stem}.png")
    draw(out, lambda: parts(scene))
    draw(out.with_name(f"{out.stem}_fits.png"), lambda: fit_table(scene.names, fixed, turned))
    for peg, name in enumerate(scene.names):
        into = [
            hole + ("" if fixed[peg, i] else " (turned)")
            for i, hole in enumerate(scene.names)
            if turned[peg, i]
        ]
        print(f"{name} fits {', '.join(into)}")
