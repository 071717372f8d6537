"""Joining the parts of a data set that several machines collected."""

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mjx_fit import files
from mjx_fit.dataset import manifest as manifest_
from mjx_fit.dataset.manifest import Manifest
from mjx_fit.dataset.writer import Writer, is_finished
from mjx_fit.errors import RequestError
from mjx_fit.progress import Progress


def merge(parts: Sequence[Path], out: Path) -> None:
    """Makes of all parts of a data set what one machine would have made.

    Args:
        parts: Folders of the parts, each complete, in any order.
        out: Folder of the whole.

    Raises:
        RequestError: A part is missing, unfinished, damaged, or of another data set; or ``out`` holds
            something else.
    """
    manifests = {folder: manifest_.read(folder) for folder in parts}
    whole = _whole(manifests)
    sources = {shard.name: folder for folder, part in manifests.items() for shard in part.shards}
    if is_finished(out, whole, sources):
        return
    with Writer(out, whole) as writer:
        missing = writer.missing(sources)
        with Progress("merge: shard", len(sources), len(sources) - len(missing)) as progress:
            for done, name in enumerate(missing, 1 + len(sources) - len(missing)):
                _copy(writer, sources[name], manifests[sources[name]], name)
                progress(done)
        for folder in parts:
            for dump in sorted((folder / "broken").glob("*.npz")):
                (out / "broken").mkdir(exist_ok=True)
                shutil.copyfile(dump, out / "broken" / dump.name)
        writer.finish()


def _whole(manifests: dict[Path, Manifest]) -> Manifest:
    """The manifest of the whole, without shards."""
    (first_folder, first), *others = manifests.items()
    of = first.part[1]
    for folder, part in manifests.items():
        if not part.complete:
            raise RequestError(
                f"data: {folder} is not allowed: it is not complete; repeat its collect command"
            )
    for folder, part in others:
        for name in ("request", "versions"):
            one, other = getattr(first, name), getattr(part, name)
            differing = sorted(key for key in one if one[key] != other.get(key))
            if differing:
                raise RequestError(
                    f"data: {folder} is not allowed: it is no part of the same whole as {first_folder} "
                    f"(its {differing[0]} differs)"
                )
        if part.part[1] != of:
            raise RequestError(
                f"data: {folder} is not allowed: it is a part of {part.part[1]}, and {first_folder} of {of}"
            )
    by_index: dict[int, Path] = {}
    for folder, part in manifests.items():
        twin = by_index.setdefault(part.part[0], folder)
        if twin != folder:
            raise RequestError(f"data: {folder} is not allowed: {twin} is the same part, {part.part[0]}")
    missing = [index for index in range(of) if index not in by_index]
    if missing:
        raise RequestError(f"data: part {missing[0]} of {of} is missing: give the folders of all parts")
    devices = " and ".join(sorted({part.device for part in manifests.values()}))
    return replace(first, part=(0, 1), device=devices, complete=False, shards=())


def _copy(writer: Writer, folder: Path, part: Manifest, name: str) -> None:
    shard = part.shard(name)
    assert shard is not None
    try:
        content = (folder / name).read_bytes()
    except OSError as error:
        raise RequestError(f"data: {name} in {folder} is damaged or missing: {error}") from None
    if files.sha256_of(content) != shard.sha256:
        raise RequestError(f"data: {name} in {folder} is damaged: its SHA-256 is not the manifest's")
    writer.write(name, shard.first_episode, shard.episodes, content)
