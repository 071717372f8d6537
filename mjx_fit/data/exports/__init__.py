"""Data sets as files of other tools: NumPy, robomimic, MCAP (ROS 2, Foxglove) and LeRobot v3."""

from collections.abc import Callable
from pathlib import Path

import yaml

from mjx_fit.data.manifest import Manifest, read_complete_manifest
from mjx_fit.utils import files, locks
from mjx_fit.utils.errors import RequestError

Writer = Callable[[Path, Manifest, Path], None]


def export(folder: Path, out: Path) -> list[Path]:
    """Write a data set for other tools, and return what was written.

    ``.npz`` and ``.hdf5`` (robomimic) are single files. ``.mcap`` comes with a map with which
    ``mjx-fit log import`` reads it again. A name without a suffix is a folder, LeRobot v3, with a map in it.
    Episodes that were not performed or diverged are omitted.

    Args:
        folder: Folder of the data set.
        out: Output; an existing file is replaced, an existing folder is not.

    Raises:
        RequestError: The data set cannot be read, or the output has another suffix or is there.
    """
    if out.suffix == "":
        return _export_folder(folder, out)
    writer = _writer(out)
    if out.is_dir():
        raise RequestError(f"--out: {out} cannot be used: it is a folder")
    manifest = read_complete_manifest(folder)
    with locks.holding_file(out):
        files.replace_with(out, lambda temporary: writer(folder, manifest, temporary))
    if out.suffix != ".mcap":
        return [out]
    from mjx_fit.data.exports.mcap import map_of

    said = out.with_suffix(".map.yaml")
    files.write_text(said, yaml.safe_dump(map_of(manifest)))
    return [out, said]


def _writer(out: Path) -> Writer:
    match out.suffix:
        case ".npz":
            from mjx_fit.data.exports.npz import write_npz as writer
        case ".hdf5":
            from mjx_fit.data.exports.robomimic import write_robomimic as writer
        case ".mcap":
            from mjx_fit.data.exports.mcap import write_mcap as writer
        case _:
            raise RequestError(
                f"--out: {out} is invalid: it must end in one of .npz, .hdf5, .mcap, or be a folder's name "
                "without a suffix (LeRobot)"
            )
    return writer


def _export_folder(folder: Path, out: Path) -> list[Path]:
    from mjx_fit.data.exports.lerobot import write_lerobot

    if out.is_file() or (out.is_dir() and any(out.iterdir())):
        raise RequestError(f"--out: {out} cannot be used: it exists; remove it or name another")
    manifest = read_complete_manifest(folder)
    write_lerobot(folder, manifest, out)
    return [out]
