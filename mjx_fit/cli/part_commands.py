"""Commands ``part import`` and ``part show``: parts from files, and pictures of parts."""

import argparse
from typing import TYPE_CHECKING

from mjx_fit.cli.options import add_command
from mjx_fit.cli.path_argument import path
from mjx_fit.config.part_sets import PART_SETS, parts_file

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mjx_fit.config.sections.scene import SceneConfig
    from mjx_fit.config.sections.shape import Shape
    from mjx_fit.scene.part_files.importing import Wanted

# Each command imports its own dependencies, so that `mjx-fit --help` answers immediately.
_MM_PER_M = 1000.0


def add_part(parsers: argparse._SubParsersAction) -> None:
    """Add ``part import`` and ``part show``."""
    whats = parsers.add_parser("part", help="import parts from files, and draw parts").add_subparsers(
        required=True, metavar="WHAT"
    )
    _add_import(whats)
    _add_show(whats)


def _add_import(whats: argparse._SubParsersAction) -> None:
    read = add_command(whats, "import", part_import, "make a part from a drawing or a solid")
    read.add_argument("file", type=path, metavar="FILE", help=".dxf, .svg, .stl, .obj, .step")
    read.add_argument(
        "--units",
        metavar="U",
        help="mm, cm, m, in or um (default: what the file states; STEP and SVG with a size keep their own)",
    )
    read.add_argument("--name", required=True, metavar="NAME", help="name of the part")
    read.add_argument(
        "--out",
        type=path,
        required=True,
        metavar="FILE.yaml",
        help="new, or with other imported parts; a picture beside it, FILE.png, is replaced",
    )
    read.add_argument(
        "--clearance", type=float, default=0.1, metavar="MM", help="air per side in mm (default 0.1)"
    )
    read.add_argument(
        "--chamfer",
        type=float,
        default=0,
        metavar="MM",
        help="width and height of the chamfer at the tip in mm (default 0); a solid may have it",
    )
    read.add_argument(
        "--tolerance",
        type=float,
        metavar="MM",
        help="error of straight lines in mm (default: a 20th of the clearance)",
    )
    solid = read.add_argument_group("solids")
    solid.add_argument("--axis", metavar="A", help="direction of insertion, as --axis=-x (default -z)")
    solid.add_argument("--depth", type=float, metavar="MM", help="insertion depth in mm (default 10)")
    solid.add_argument(
        "--at", type=float, metavar="MM", help="distance of the section from the tip in mm (default: middle)"
    )


def _add_show(whats: argparse._SubParsersAction) -> None:
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
    from mjx_fit.scene.part_files.importing import import_part, shape_tree
    from mjx_fit.scene.part_files.parts_yaml import as_yaml, require_name, require_yaml, with_part
    from mjx_fit.scene.part_rules import require_possible
    from mjx_fit.utils.errors import RequestError
    from mjx_fit.utils.files import require_writable, write_text

    wanted, picture = wanted_of(args), args.out.with_suffix(".png")
    require_name(args.name)
    require_yaml(args.out)
    require_writable(args.out)
    require_writable(picture)
    if picture.exists() and not args.out.exists():
        raise RequestError(f"--out: {args.out} cannot be used: {picture} exists and would be replaced")
    found = import_part(args.file, wanted)
    shape = shape_tree(args.name, found, args.clearance / _MM_PER_M, wanted.chamfer_m)
    tree = with_part(args.out, shape)
    config = config_from_tree(tree)
    require_possible(config.scene.shapes[-1], config.scene)
    text = as_yaml(tree)
    write_text(args.out, text)
    draw(picture, lambda: parts(config.scene))
    x, y = (_MM_PER_M * side for side in found.size_m)
    print(
        f"{args.name}: {x:.4g} by {y:.4g} mm, {found.area_m2 * _MM_PER_M**2:.5g} mm², {found.corners} "
        f"corners, {args.clearance:g} mm of air per side"
    )
    print(f"unit: {found.unit}")
    if found.parts + found.holes > 1:
        print(f"outlines: {found.parts} apart, {found.holes} inside of others, which bound holes")
    print(f"straight lines err by at most {_MM_PER_M * wanted.tolerance_m:.3g} mm")
    if found.change_m is not None:
        print(
            f"the section changes by {_MM_PER_M * found.change_m:.3f} mm over "
            f"{_MM_PER_M * wanted.depth_m:g} mm"
        )
    _tell_lopsided(config.scene.shapes[-1:], config.scene)
    print(args.out)


def _tell_lopsided(shapes: "Sequence[Shape]", scene: "SceneConfig") -> None:
    """Say which parts training cannot mirror."""
    from mjx_fit.scene.outline import is_its_own_mirror_image

    for shape in shapes:
        if not is_its_own_mirror_image(shape, scene):
            print(f"{shape.name} is not its own mirror image in y: train with --set train.mirror=false")


def wanted_of(args: argparse.Namespace) -> "Wanted":
    """Return what the options of ``part import`` ask for.

    Raises:
        RequestError: A value is not allowed.
    """
    from mjx_fit.scene.part_files.importing import DRAWINGS, UNITS_M, Wanted
    from mjx_fit.scene.part_files.solid import AXES
    from mjx_fit.utils.errors import RequestError, require, shown

    of_solids = {"--axis": args.axis, "--depth": args.depth, "--at": args.at}
    for option, value in of_solids.items():
        if value is not None and args.file.suffix.lower() in DRAWINGS:
            raise RequestError(
                f"{option}: {shown(value)} cannot be used: {args.file} is a drawing, not a solid"
            )
    if args.units is not None and args.units not in UNITS_M:
        raise RequestError(f"--units: {shown(args.units)} is invalid: expected {', '.join(UNITS_M)}")
    axis = "-z" if args.axis is None else args.axis
    if axis not in AXES:
        raise RequestError(f"--axis: {shown(axis)} is invalid: expected {', '.join(AXES)}")
    depth = 10.0 if args.depth is None else args.depth
    tolerance = args.clearance / 20 if args.tolerance is None else args.tolerance
    require("--clearance", args.clearance, 0.05, 5)
    require("--depth", depth, 1, 80)
    require("--chamfer", args.chamfer, 0, min(5, depth / 2))
    require("--tolerance", tolerance, 0.0001, args.clearance / 2)
    if args.at is not None:
        require("--at", args.at, args.chamfer, depth, "the section is taken within the insertion depth")
    return Wanted(
        args.units,
        tolerance / _MM_PER_M,
        axis,
        None if args.at is None else args.at / _MM_PER_M,
        depth / _MM_PER_M,
        args.chamfer / _MM_PER_M,
    )


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
    _tell_lopsided(scene.shapes, scene)
