"""Schema of manifests: names, counts and bounds, checked on reading.

A manifest determines which files are opened and how much is read, so it is not trusted before this check.
"""

from typing import Annotated, Any, Literal, NotRequired

from pydantic import ConfigDict, Field, TypeAdapter
from typing_extensions import TypedDict

from mjx_fit.config.sections.scene import MOST_TYPES
from mjx_fit.control.policy_file import NAME
from mjx_fit.utils import bounded_json

MAX_EPISODES, MAX_ACTIONS, MAX_BATCH, MAX_SEQUENCE = 10**7, 1000, 65536, 30
"""Limits of a single command."""
LARGEST = 4 * 2**30
"""Maximum size of a manifest, bytes: 10^7 episodes in shards of one."""
SHARD_NAME = r"^shard-[0-9]{8,12}\.h5$"

_STRICT = ConfigDict(strict=True, extra="forbid")
_Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
_Words = Annotated[str, Field(max_length=1000, pattern=r"^[^\x00-\x1f\x7f-\x9f]*$")]
_Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=1000)]


_Episodes = Annotated[int, Field(ge=1, le=MAX_EPISODES)]
_Index = Annotated[int, Field(ge=0, le=MAX_EPISODES)]


class _Shard(TypedDict):
    __pydantic_config__ = _STRICT  # pyright: ignore[reportGeneralTypeIssues]

    name: Annotated[str, Field(pattern=SHARD_NAME)]
    first_episode: _Index
    episodes: _Episodes
    bytes: Annotated[int, Field(ge=1, le=2**50)]
    sha256: _Digest
    device: _Words


class _Log(TypedDict):
    __pydantic_config__ = _STRICT  # pyright: ignore[reportGeneralTypeIssues]

    name: _Words
    sha256: _Digest
    attempts: Annotated[list[Annotated[list[float], Field(min_length=2, max_length=2)]], Field(min_length=1)]


class _Request(TypedDict):
    __pydantic_config__ = _STRICT  # pyright: ignore[reportGeneralTypeIssues]

    episodes: _Episodes
    steps: Annotated[int, Field(ge=1, le=MAX_ACTIONS)]
    policy: Annotated[str, Field(pattern=rf"^{NAME.pattern}$", max_length=60)]
    seed: Annotated[int, Field(ge=0, lt=2**32)]
    batch: Annotated[int, Field(ge=1, le=MAX_BATCH)]
    sequence: Annotated[int, Field(ge=1, le=MAX_SEQUENCE)]
    sensor: NotRequired[_Words]
    turns: NotRequired[Literal[True]]
    labelled: NotRequired[Literal[True]]
    logs: NotRequired[Annotated[list[_Log], Field(min_length=1)]]
    engine: Literal["mjx", "native", "robot"]
    config: dict[str, dict[str, Any]]


class _Manifest(TypedDict):
    __pydantic_config__ = _STRICT  # pyright: ignore[reportGeneralTypeIssues]

    request: _Request
    part: Annotated[list[_Index], Field(min_length=2, max_length=2)]
    versions: dict[_Words, _Words]
    shapes: Annotated[list[_Name], Field(min_length=1, max_length=MOST_TYPES)]
    complete: bool
    shards: list[_Shard]


_SCHEMA = TypeAdapter(_Manifest)


def require(fields: Any) -> dict[str, Any]:
    """Validate and return the fields of a manifest, without format and digest.

    Raises:
        ValueError: A field is invalid; the message names the first one.
    """
    manifest = bounded_json.check(_SCHEMA, fields)
    index, of = manifest["part"]
    if index >= of:
        raise ValueError(f"part: {index} of {of} cannot be used: parts are counted from 0")
    if len(set(manifest["shapes"])) < len(manifest["shapes"]):
        raise ValueError(f"shapes: {', '.join(manifest['shapes'])}: the names must differ")
    request = manifest["request"]
    asked = request["config"].get("scene", {}).get("shapes")
    if isinstance(asked, list) and len(asked) != len(manifest["shapes"]):
        raise ValueError(f"shapes: {len(manifest['shapes'])} names: request.config has {len(asked)} shapes")
    if (request["engine"] == "robot") != ("logs" in request):
        raise ValueError("request.logs: expected with the engine robot, and with no other")
    if "labelled" in request and "logs" not in request:
        raise ValueError("request.labelled: expected with the engine robot only")
    if request["episodes"] % request["sequence"]:
        raise ValueError("request.episodes: expected a multiple of request.sequence")
    _require_shards(manifest["shards"], request)
    there = sum(shard["episodes"] for shard in manifest["shards"])
    if manifest["complete"] and of == 1 and there != request["episodes"]:
        raise ValueError(f"complete: its shards have {there} of {request['episodes']} episodes")
    return manifest


def _require_shards(shards: list[dict[str, Any]], request: dict[str, Any]) -> None:
    """Check that each shard is named after its first episode and that no two shards overlap."""
    most = max(request["batch"], request["sequence"])
    end = 0
    for shard in sorted(shards, key=lambda shard: shard["first_episode"]):
        name, first, n = shard["name"], shard["first_episode"], shard["episodes"]
        if name != f"shard-{first:08d}.h5":
            raise ValueError(f"shards: {name} is not the name of a shard that starts at episode {first}")
        if n > most:
            raise ValueError(f"shards: {name}: {n} episodes cannot be used: a batch has at most {most}")
        if first < end:
            raise ValueError(f"shards: {name}: its episodes overlap with another shard")
        end = first + n
        if end > request["episodes"]:
            raise ValueError(f"shards: {name}: it ends after the last of {request['episodes']} episodes")
