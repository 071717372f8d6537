"""The manifest of a data set: what was asked, and which shards are complete, with their SHA-256.

It carries a SHA-256 of itself, so that a change of a single byte of it is noticed.
"""

import hashlib
import json
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from mjx_fit.data import manifest_schema
from mjx_fit.utils import bounded_json, files
from mjx_fit.utils.errors import RequestError

MANIFEST_NAME = "manifest.json"
FORMAT = 2


class FormatError(ValueError):
    """The manifest is of a format that this version does not read."""


@dataclass(frozen=True)
class Shard:
    """A file that is complete.

    Attributes:
        name: Its name.
        first_episode: Least id of its episodes, which follow one another.
        episodes: How many there are.
        bytes: Its size.
        sha256: Its SHA-256, hexadecimal.
        device: What its numbers were computed on; another device may round otherwise.
    """

    name: str
    first_episode: int
    episodes: int
    bytes: int
    sha256: str
    device: str


@dataclass(frozen=True)
class Manifest:
    """What a folder holds.

    Attributes:
        request: What was asked, with the resolved configuration.
        part: Which part of the whole this folder is to hold, from 0, and of how many.
        versions: Versions of all that its numbers may depend on.
        shapes: Names of the shapes, in the order of their indices.
        complete: Whether all shards of the part are there.
        shards: Those that are, by name.
    """

    request: dict[str, Any]
    part: tuple[int, int]
    versions: dict[str, str]
    shapes: tuple[str, ...]
    complete: bool = False
    shards: tuple[Shard, ...] = field(default=())

    def shard(self, name: str) -> Shard | None:
        """The shard of that name, or None."""
        return next((shard for shard in self.shards if shard.name == name), None)

    def with_shard(self, new: Shard) -> "Manifest":
        """The same with one shard more, or with another in its place."""
        others = [shard for shard in self.shards if shard.name != new.name]
        return replace(self, shards=tuple(sorted([*others, new], key=lambda shard: shard.name)))


def manifest_text(manifest: Manifest) -> str:
    """The manifest as text."""
    tree = {"format": FORMAT, **asdict(manifest)}
    return json.dumps(tree | {"sha256": _digest(tree)}, indent=1) + "\n"


def _digest(tree: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(tree, sort_keys=True).encode()).hexdigest()


def parse_manifest(text: str) -> Manifest:
    """What ``render`` wrote.

    Raises:
        FormatError: It is of another format.
        ValueError: It is damaged.
    """
    fields = _whole(bounded_json.loads(text, manifest_schema.LARGEST))
    manifest = Manifest(
        **fields
        | {
            "part": tuple(fields["part"]),
            "shapes": tuple(fields["shapes"]),
            "shards": tuple(Shard(**shard) for shard in fields["shards"]),
        }
    )
    if manifest_text(manifest) != text:
        raise ValueError("its SHA-256 does not fit")
    return manifest


def _whole(tree: Any) -> dict[str, Any]:
    """The fields of a manifest whose format and digest are right, as its schema allows them."""
    if not isinstance(tree, dict) or not isinstance(told := tree.get("format"), int):
        raise ValueError("it says no format")
    # Formats before 2 had no digest: what they say of themselves has to be believed.
    body = {name: value for name, value in tree.items() if name != "sha256"}
    if told != 1 and tree.get("sha256") != _digest(body):
        raise ValueError("its SHA-256 does not fit")
    if told != FORMAT:
        raise FormatError(f"its format is {told!r}, not {FORMAT}")
    del body["format"]
    return manifest_schema.require(body)


def read_complete_manifest(folder: Path) -> Manifest:
    """The manifest of a data set that is complete.

    Raises:
        RequestError: As in ``read``, or it is not complete.
    """
    manifest = read_manifest(folder)
    if not manifest.complete:
        raise RequestError(f"data: {folder} cannot be used: it is not complete; repeat its collect command")
    return manifest


def read_manifest(folder: Path) -> Manifest:
    """The manifest of a data set.

    Raises:
        RequestError: The folder is not there, or holds no data set, or one that cannot be read.
    """
    if not folder.is_dir():
        what = "it is a file; give its folder" if folder.is_file() else "there is no such folder"
        raise RequestError(f"data: {folder} cannot be used: {what}")
    try:
        return parse_manifest(read_manifest_text(folder))
    except FileNotFoundError:
        raise RequestError(
            f"data: {folder} cannot be used: it holds no {MANIFEST_NAME}, so it is no data set"
        ) from None
    except FormatError as error:
        raise RequestError(f"data: {folder} cannot be used: {error}") from None
    except (OSError, ValueError) as error:
        raise RequestError(
            f"data: {folder} cannot be used: its {MANIFEST_NAME} is damaged: {error}"
        ) from None


def read_manifest_text(folder: Path) -> str:
    """The text of the manifest of a folder.

    Raises:
        OSError: It cannot be read.
        ValueError: It is no text, or larger than any manifest.
    """
    return bounded_json.read_text(folder / MANIFEST_NAME, manifest_schema.LARGEST)


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Writes it as a whole or not at all."""
    files.write_text(folder / MANIFEST_NAME, manifest_text(manifest))
