"""Merge the parts of a data set that several machines collected."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mjx_fit.data.hdf5 import decode
from mjx_fit.data.manifest import MANIFEST_NAME, Manifest, Shard, read_complete_manifest, read_manifest
from mjx_fit.data.reader import content_of
from mjx_fit.data.writer import Writer, is_finished
from mjx_fit.utils import files, provenance
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.filesystem import path_inside
from mjx_fit.utils.progress import Progress


def merge(parts: Sequence[Path], out: Path) -> None:
    """Merge all parts of a data set into the one that a single machine would have made; a rerun resumes.

    Args:
        parts: Folders of all parts, each complete, in any order.
        out: Folder of the merged data set.

    Raises:
        RequestError: A part is missing, unfinished, damaged, or of another data set; or ``out`` holds
            something else.
    """
    manifests = {folder: read_complete_manifest(folder) for folder in parts}
    if len({folder.resolve() for folder in parts}) < len(parts):
        raise RequestError("data: a folder is given twice: give each part once")
    whole = _whole(manifests)
    shards = {shard.name: shard for part in manifests.values() for shard in part.shards}
    sources = {shard.name: folder for folder, part in manifests.items() for shard in part.shards}
    _require_of_these(out, shards)
    if is_finished(out, whole, shards):
        return
    with Writer(out, whole) as writer:
        missing = writer.missing(shards)
        with Progress("merge: shard", len(shards), len(shards) - len(missing)) as progress:
            for done, name in enumerate(missing, 1 + len(shards) - len(missing)):
                writer.write(shards[name], _content(sources[name], shards[name], whole.request))
                progress(done)
        for folder in parts:
            for dump in sorted((folder / "broken").glob("*.npz")):
                files.write_bytes(path_inside(out, "broken") / dump.name, dump.read_bytes())
        writer.finish()


def _whole(manifests: dict[Path, Manifest]) -> Manifest:
    """Return the manifest of the merged data set, without shards."""
    (first_folder, first), *others = manifests.items()
    of = first.part[1]
    for folder, part in others:
        one, other = first.request, part.request
        differing = [f"its {key} differs" for key in sorted(one | other) if one.get(key) != other.get(key)]
        differing += [
            f"its {name} is {here}, and there it is {there}"
            for name, there, here in provenance.differing(first.versions, part.versions)
        ]
        if differing:
            raise RequestError(
                f"data: {folder} cannot be used: it is not a part of the same data set as {first_folder} "
                f"({differing[0]})"
            )
        if part.format != first.format:
            raise RequestError(
                f"data: {folder} cannot be used: its format is {part.format}, and that of {first_folder} is "
                f"{first.format}"
            )
        if part.part[1] != of:
            raise RequestError(
                f"data: {folder} cannot be used: it is a part of {part.part[1]}, and {first_folder} of {of}"
            )
    by_index: dict[int, Path] = {}
    for folder, part in manifests.items():
        twin = by_index.setdefault(part.part[0], folder)
        if twin != folder:
            raise RequestError(f"data: {folder} cannot be used: {twin} is the same part, {part.part[0]}")
    missing = [index for index in range(of) if index not in by_index]
    if missing:
        raise RequestError(f"data: part {missing[0]} of {of} is missing: give the folders of all parts")
    return replace(first, part=(0, 1), complete=False, shards=())


def _require_of_these(out: Path, shards: dict[str, Shard]) -> None:
    """Check that shards merged earlier come from these parts."""
    if not (out / MANIFEST_NAME).is_file():
        return
    for there in read_manifest(out).shards:
        if there.name in shards and shards[there.name] != there:
            raise RequestError(f"--out: {out} cannot be used: its {there.name} is not of these parts")


def _content(folder: Path, shard: Shard, request: dict[str, Any]) -> bytes:
    """Return the content of a shard, after a check for damage."""
    try:
        content = content_of(folder, shard)
        decode(content, shard, request)
    except (OSError, ValueError) as error:
        raise RequestError(f"data: {shard.name} in {folder} is damaged or missing: {error}") from None
    return content
