"""Manifest of a data set: its request and its completed shards, with their SHA-256.

The manifest includes its own SHA-256, so that a change of a single byte is detected.
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
ROBOT = "robot"
"""Engine, and policy, of data sets that come from logs of robots."""
FORMAT = 4
"""Version of the files that are written: 3 adds the physics of randomised worlds, 4 turns of the TCP and
estimates of more than x and y."""
READABLE = (2, 3, 4)


class FormatError(ValueError):
    """The manifest has a format that this version does not support."""


@dataclass(frozen=True)
class Shard:
    """A completed file of a data set.

    Attributes:
        name: Name of the file.
        first_episode: Id of the first episode; ids are consecutive.
        episodes: Number of episodes.
        bytes: Size of the file, bytes.
        sha256: SHA-256 of the file, hexadecimal.
        device: Device that computed the data; other devices may round differently.
    """

    name: str
    first_episode: int
    episodes: int
    bytes: int
    sha256: str
    device: str


@dataclass(frozen=True)
class Manifest:
    """Contents of the folder of a data set.

    Attributes:
        request: Request of the data set, with the resolved configuration.
        part: Index of this folder's part, from 0, and the number of parts.
        versions: Versions of all packages that may affect the numbers.
        shapes: Names of the shapes, in the order of their indices.
        complete: True if all shards of the part exist.
        shards: Existing shards, sorted by name.
        format: Version of the files.
    """

    request: dict[str, Any]
    part: tuple[int, int]
    versions: dict[str, str]
    shapes: tuple[str, ...]
    complete: bool = False
    shards: tuple[Shard, ...] = field(default=())
    format: int = FORMAT

    def shard(self, name: str) -> Shard | None:
        """Return the shard of a name, or None."""
        return next((shard for shard in self.shards if shard.name == name), None)

    def with_shard(self, new: Shard) -> "Manifest":
        """Return a copy with a shard added or replaced."""
        others = [shard for shard in self.shards if shard.name != new.name]
        return replace(self, shards=tuple(sorted([*others, new], key=lambda shard: shard.name)))


def manifest_text(manifest: Manifest) -> str:
    """Format the manifest as JSON text."""
    fields = asdict(manifest)
    tree = {"format": fields.pop("format"), **fields}
    return json.dumps(tree | {"sha256": _digest(tree)}, indent=1) + "\n"


def _digest(tree: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(tree, sort_keys=True).encode()).hexdigest()


def parse_manifest(text: str) -> Manifest:
    """Parse the text of ``manifest_text``.

    Raises:
        FormatError: The format is not supported.
        ValueError: The manifest is damaged.
    """
    fields, version = _whole(bounded_json.loads(text, manifest_schema.LARGEST))
    fields["part"], fields["shapes"] = tuple(fields["part"]), tuple(fields["shapes"])
    fields["shards"] = tuple(Shard(**shard) for shard in fields["shards"])
    manifest = Manifest(**fields, format=version)
    if manifest_text(manifest) != text:
        raise ValueError("its SHA-256 does not fit")
    return manifest


def _whole(tree: Any) -> tuple[dict[str, Any], int]:
    """Check the format, digest and schema of a manifest and return its fields and its format."""
    if not isinstance(tree, dict) or not isinstance(told := tree.get("format"), int):
        raise ValueError("it has no format")
    # Formats before 2 had no digest and cannot be verified.
    body = {name: value for name, value in tree.items() if name != "sha256"}
    if told != 1 and tree.get("sha256") != _digest(body):
        raise ValueError("its SHA-256 does not fit")
    if told not in READABLE:
        raise FormatError(f"its format is {told!r}, not one of {', '.join(map(str, READABLE))}")
    del body["format"]
    return manifest_schema.require(body), told


def read_complete_manifest(folder: Path) -> Manifest:
    """Read the manifest of a complete data set.

    Raises:
        RequestError: As in ``read_manifest``, or the data set is not complete.
    """
    manifest = read_manifest(folder)
    if not manifest.complete:
        raise RequestError(f"data: {folder} cannot be used: it is not complete; rerun its collect command")
    return manifest


def knows_truth(request: dict[str, Any]) -> bool:
    """Tell whether types and places of holes are known: in simulation, and in a robot's logs with labels."""
    return request["engine"] != ROBOT or request.get("labelled", False)


def require_truth(folder: Path, request: dict[str, Any]) -> None:
    """Check that types and places of the holes of a data set are known.

    Raises:
        RequestError: They are not: it comes from a robot, and the map of its logs said nothing about them.
    """
    if not knows_truth(request):
        raise RequestError(
            f"data: {folder} cannot be used: it comes from logs of a robot, and types and places of holes "
            "are needed: import them with truth in their map"
        )


def read_manifest(folder: Path) -> Manifest:
    """Read the manifest of a data set.

    Raises:
        RequestError: The folder does not exist, or holds no data set or an unreadable one.
    """
    if not folder.is_dir():
        what = "it is a file; give its folder" if folder.is_file() else "there is no such folder"
        raise RequestError(f"data: {folder} cannot be used: {what}")
    try:
        return parse_manifest(read_manifest_text(folder))
    except FileNotFoundError:
        raise RequestError(
            f"data: {folder} cannot be used: it holds no {MANIFEST_NAME}, so it is not a data set"
        ) from None
    except FormatError as error:
        raise RequestError(f"data: {folder} cannot be used: {error}") from None
    except (OSError, ValueError) as error:
        raise RequestError(
            f"data: {folder} cannot be used: its {MANIFEST_NAME} is damaged: {error}"
        ) from None


def read_manifest_text(folder: Path) -> str:
    """Read the text of the manifest in a folder.

    Raises:
        OSError: The file cannot be read.
        ValueError: The file is not text, or is larger than any manifest.
    """
    return bounded_json.read_text(folder / MANIFEST_NAME, manifest_schema.LARGEST)


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write a manifest atomically."""
    files.write_text(folder / MANIFEST_NAME, manifest_text(manifest))
