"""Write shards to a data set; a kill at any moment loses only the shard in progress.

A shard is written under a temporary name, synced and renamed; then the manifest is rewritten. Every shard
that the manifest names is therefore complete, and a killed collection resumes after it.
"""

import sys
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int

from mjx_fit.config.schema import config_differences, config_from_stored, config_from_tree, config_to_tree
from mjx_fit.data.manifest import MANIFEST_NAME, Manifest, Shard, read_manifest, write_manifest
from mjx_fit.utils import files, locks, provenance
from mjx_fit.utils.errors import RequestError

_SIDE = {"broken", "report"}
"""Folders allowed next to the shards."""


def new_manifest(request: dict[str, Any], part: tuple[int, int]) -> Manifest:
    """Return the manifest of an empty data set, with the versions of this installation."""
    return Manifest(request, part, provenance.versions(), config_from_stored(request["config"]).scene.names)


def new_shard(name: str, episodes: Int[np.ndarray, "n"], content: bytes) -> Shard:
    """Return the manifest entry of a shard with these episodes and this content, computed on this device."""
    size, digest = len(content), files.sha256_of(content)
    return Shard(name, int(episodes[0]), len(episodes), size, digest, provenance.device())


class NewShard(NamedTuple):
    """A shard on its way to its folder.

    Attributes:
        shard: Its entry in the manifest.
        content: Content of its file; empty once it is written.
        counts: What is in it, for progress.
    """

    shard: Shard
    content: bytes
    counts: dict[str, int]


def store_shard(folder: Path, new: NewShard) -> NewShard:
    """Write the file of a shard, and return what is small of it."""
    files.write_bytes(folder / new.shard.name, new.content)
    return new._replace(content=b"")


def is_finished(folder: Path, wanted: Manifest, names: Iterable[str]) -> bool:
    """Return whether the folder holds all wanted shards, undamaged. Writes nothing.

    Raises:
        RequestError: The folder holds another data set.
    """
    if not (folder / MANIFEST_NAME).is_file():
        return False
    there = read_manifest(folder)
    _require_same(folder, there, wanted)
    return there.complete and all(is_whole(folder, there, name) for name in names)


def is_whole(folder: Path, manifest: Manifest, name: str) -> bool:
    """Return whether the manifest lists a shard and its file has the listed digest."""
    shard, path = manifest.shard(name), folder / name
    return shard is not None and path.is_file() and files.sha256(path) == shard.sha256


class Writer:
    """Context manager that locks a folder and writes shards into it.

    Args:
        folder: Where to; made if it is not there.
        wanted: The manifest of the whole, or of the part, without shards.

    Raises:
        RequestError: The folder holds something else, or another process writes to it.
    """

    def __init__(self, folder: Path, wanted: Manifest):
        self._folder, self._wanted = folder, wanted

    def __enter__(self) -> "Writer":
        _require_ours(self._folder)
        with ExitStack() as stack:
            self._hold = stack.enter_context(locks.holding(self._folder))
            self._manifest = self._begin()
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error) -> None:
        self._stack.__exit__(*error)

    def _begin(self) -> Manifest:
        if (self._folder / MANIFEST_NAME).is_file():
            there = read_manifest(self._folder)
            _require_same(self._folder, there, self._wanted)
            return there
        write_manifest(self._folder, self._wanted)
        return self._wanted

    def missing(self, names: Iterable[str]) -> list[str]:
        """Those of the shards that are not there, or not whole.

        Raises:
            RequestError: There are some, but other versions made the rest, and may compute other bytes.
        """
        missing = [name for name in names if not is_whole(self._folder, self._manifest, name)]
        for name, there, here in provenance.differing(self._manifest.versions, self._wanted.versions):
            if missing:
                raise RequestError(
                    f"--out: {self._folder} cannot be completed here: it was begun with {name} {there}, and "
                    f"here is {here}"
                )
        if missing and self._manifest.format != self._wanted.format:
            raise RequestError(
                f"--out: {self._folder} cannot be completed: it was begun in format {self._manifest.format}, "
                f"and this version writes format {self._wanted.format}; collect into another folder"
            )
        for name in missing:
            if self._manifest.shard(name) is not None:
                print(
                    f"mjx-fit: {name} in {self._folder} is damaged or missing: it is collected again",
                    file=sys.stderr,
                )
        return missing

    def write(self, shard: Shard, content: bytes) -> None:
        """Add or replace a shard, whose file is to hold this content.

        Raises:
            WorkError: The folder was taken away.
        """
        self.add(self._store_here(NewShard(shard, content, {})).shard)

    def storing(self, *, here: bool) -> Callable[[NewShard], NewShard]:
        """Return the function that writes files; ``add`` their shards afterwards.

        Args:
            here: Whether it stays in this process. Elsewhere nobody knows whether the folder was taken away:
                ``add`` tells it only then.
        """
        return self._store_here if here else partial(store_shard, self._folder.absolute())

    def _store_here(self, new: NewShard) -> NewShard:
        self._hold.require()
        return store_shard(self._folder, new)

    def add(self, shard: Shard) -> None:
        """Add or replace a shard whose file is written.

        Raises:
            WorkError: The folder was taken away.
        """
        self._save(self._manifest.with_shard(shard))

    def finish(self) -> None:
        """Mark the data set complete. A complete data set is not changed again."""
        self._save(replace(self._manifest, complete=True))

    def _save(self, manifest: Manifest) -> None:
        if manifest != self._manifest:
            self._hold.require()
            write_manifest(self._folder, manifest)
            self._manifest = manifest


def _require_ours(folder: Path) -> None:
    """Check that the folder is new or holds an unfinished data set."""
    if folder.exists() and not folder.is_dir():
        raise RequestError(f"--out: {folder} is invalid: expected a folder")
    if not folder.is_dir() or (folder / MANIFEST_NAME).is_file():
        return
    foreign = files.foreign(folder, {MANIFEST_NAME, *_SIDE})
    if foreign:
        raise RequestError(f"--out: {folder} cannot be used: it holds other files ({foreign[0]})")


def _require_same(folder: Path, there: Manifest, wanted: Manifest) -> None:
    names = sorted(there.request.keys() | wanted.request.keys())
    pairs = [(name, _filled(name, there), _filled(name, wanted)) for name in names]
    for name, old, new in [*pairs, ("part", there.part, wanted.part)]:
        if old != new:
            detail = f": {old!r} there, {new!r} here"
            if name == "config":
                detail = f": {config_differences(config_from_tree(old), config_from_tree(new))[0]}"
            raise RequestError(
                f"--out: {folder} cannot be used: it holds another run (its {name} differs{detail})"
            )


def _filled(name: str, manifest: Manifest) -> Any:
    """Return an entry of the request; an older version stored a configuration with fewer keys."""
    value = manifest.request.get(name)
    return config_to_tree(config_from_stored(value)) if name == "config" and value else value
