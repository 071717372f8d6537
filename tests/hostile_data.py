"""Hostile data sets: valid digests, invalid content."""

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import jax
import numpy as np
from h5py import h5d, h5p, h5s, h5t
from synthetic import make_episodes

from mjx_fit.config.schema import Config
from mjx_fit.data.episode import Episode
from mjx_fit.data.hdf5 import encode
from mjx_fit.data.hdf5_check_layout import type_of
from mjx_fit.data.manifest import Manifest, write_manifest
from mjx_fit.data.plan import Plan
from mjx_fit.data.writer import new_manifest, new_shard

EPISODES, STEPS = 6, 4
NAME = "shard-00000000.h5"
SECRET = b"what a stranger may not read " * 100
Change = Callable[[h5py.File], None]


def episodes() -> Episode:
    """As ``collect`` would make them, but for what the numbers say."""
    made = make_episodes(EPISODES, STEPS, min_length=2)
    made = replace(made, **{name: np.asarray(getattr(made, name), type_of(name)) for name in ("episode",)})
    ids = {name: np.asarray(getattr(made, name), np.int64) for name in ("episode", "sequence", "number")}
    return jax.tree.map(np.asarray, replace(made, **ids))


def write(folder: Path, change: Change | None = None, **fields: Any) -> Path:
    """A data set of one shard, changed, with a manifest that holds the changed shard's digest."""
    request = Plan(episodes=EPISODES, actions=STEPS, engine="native").request(Config())
    content = encode(episodes(), request)
    if change is not None:
        buffer = io.BytesIO(content)
        with h5py.File(buffer, "r+") as file:
            change(file)
        content = buffer.getvalue()
    return write_content(folder, content, request, **fields)


def write_content(folder: Path, content: bytes, request: dict[str, Any] | None = None, **fields: Any) -> Path:
    """A data set whose shard has this content."""
    request = request or Plan(episodes=EPISODES, actions=STEPS, engine="native").request(Config())
    shard = replace(new_shard(NAME, np.arange(EPISODES), content), **fields)
    made = replace(new_manifest(request, (0, 1)), complete=True, shards=(shard,))
    folder.mkdir()
    (folder / NAME).write_bytes(content)
    write_manifest(folder, made)
    return folder


def manifest() -> Manifest:
    """Of such a data set."""
    request = Plan(episodes=EPISODES, actions=STEPS, engine="native").request(Config())
    shard = new_shard(NAME, np.arange(EPISODES), b"content")
    return replace(new_manifest(request, (0, 1)), complete=True, shards=(shard,))


def put(name: str, value: Any, **settings: Any) -> Change:
    """The field is replaced; a function makes the new value of the old one."""

    def change(file: h5py.File) -> None:
        made = value(np.asarray(file[name])) if callable(value) else value
        del file[name]
        file.create_dataset(name, data=made, **settings)

    return change


def at(name: str, place: Any, value: Any) -> Change:
    """One number is another."""

    def change(file: h5py.File) -> None:
        dataset = file[name]
        assert isinstance(dataset, h5py.Dataset)
        dataset[place] = value

    return change


def cast(name: str, dtype: Any) -> Change:
    return put(name, lambda old: old.astype(dtype))


def empty(name: str, shape: tuple[int, ...], **settings: Any) -> Change:
    """Declared and never written."""

    def change(file: h5py.File) -> None:
        dtype = file[name].dtype
        del file[name]
        file.create_dataset(name, shape, dtype, chunks=shape[:1] and (1, *shape[1:]), **settings)

    return change


def of_type(name: str, dtype: Any) -> Change:
    """Of another type of HDF5, as empty as it may be."""

    def change(file: h5py.File) -> None:
        shape = file[name].shape
        del file[name]
        file.create_dataset(name, shape, dtype)

    return change


def external(target: Path) -> Change:
    """The numbers of a field lie in another file of the system."""

    def change(file: h5py.File) -> None:
        shape = file["end_qpos"].shape
        del file["end_qpos"]
        file.create_dataset("end_qpos", shape, np.float32, external=[(str(target), 0, h5py.h5f.UNLIMITED)])

    return change


def virtual(target: Path) -> Change:
    def change(file: h5py.File) -> None:
        shape = file["end_qpos"].shape
        del file["end_qpos"]
        layout = h5py.VirtualLayout(shape, np.float32)
        layout[:] = h5py.VirtualSource(str(target), "secret", shape=shape)
        file.create_virtual_dataset("end_qpos", layout)

    return change


def link(name: str, made: Any) -> Change:
    def change(file: h5py.File) -> None:
        del file[name]
        file[name] = made

    return change


def cycle(file: h5py.File) -> None:
    del file["trace"]
    file["trace"] = file["/"]


def moved(file: h5py.File) -> None:
    """The field is elsewhere in the file, and a soft link stands in its place."""
    file.move("end_qpos", "hidden")
    file["end_qpos"] = h5py.SoftLink("/hidden")


def aside(file: h5py.File) -> None:
    file["more"] = np.zeros(3)


def attribute(file: h5py.File) -> None:
    """Attributes are for people: nobody reads them here."""
    file.attrs["shapes"] = np.arange(1000)


def group_for_field(file: h5py.File) -> None:
    del file["length"]
    file.create_group("length")


def field_for_group(file: h5py.File) -> None:
    del file["trace"]
    file["trace"] = np.zeros(3)


def no_space(file: h5py.File) -> None:
    del file["length"]
    file["length"] = h5py.Empty("i4")


def filtered_twice(file: h5py.File) -> None:
    """What unpacks to a million times its size."""
    values = np.asarray(file["trace/wrench_sensor"])
    del file["trace/wrench_sensor"]
    settings = h5p.create(h5p.DATASET_CREATE)
    settings.set_chunk(values.shape)
    settings.set_deflate(9)
    settings.set_deflate(9)
    made = h5d.create(
        file["trace"].id, b"wrench_sensor", h5t.IEEE_F32LE, h5s.create_simple(values.shape), settings
    )
    made.write(h5s.ALL, h5s.ALL, values)


def twos(name: str) -> Change:
    """A truth value that is neither."""

    def change(file: h5py.File) -> None:
        dataset = file[name]
        raw = np.full(dataset.shape, 2, np.int8)
        dataset.id.write(h5s.ALL, h5s.ALL, raw, dataset.id.get_type())

    return change


WRENCH, TIP = "trace/wrench_sensor", "trace/tip_pos_world"
HUGE = (EPISODES, 10**9)
SHARDS: dict[str, Change] = {
    # Types.
    "vlen": of_type("length", h5py.vlen_dtype(np.int32)),
    "vlen of floats": of_type(TIP, h5py.vlen_dtype(np.float32)),
    "text": put("length", ["two"] * EPISODES),
    "text of a fixed length": of_type("policy", "S8"),
    "compound": of_type("end_qvel", [("a", "f4"), ("b", "i8")]),
    "reference": of_type("length", h5py.ref_dtype),
    "region reference": of_type("length", h5py.regionref_dtype),
    "opaque": of_type("length", h5py.opaque_dtype(np.dtype("M8[s]"))),
    "an array in each place": of_type("length", np.dtype((np.int32, (3,)))),
    "another enumeration": of_type("valid", h5py.enum_dtype({"FALSE": 0, "TRUE": 1, "MAYBE": 2}, "i1")),
    "double": cast("tare_sensor", np.float64),
    "double wrench": cast(WRENCH, np.float64),
    "half": cast(TIP, np.float16),
    "other byte order": cast("end_qpos", ">f4"),
    "complex": cast("end_qpos", np.complex64),
    "float length": cast("length", np.float32),
    "long length": cast("length", np.int64),
    "unsigned length": cast("length", np.uint32),
    "short ids": cast("episode", np.int32),
    "numbers for truth": cast("inserted", np.int8),
    "truth for numbers": cast("policy", bool),
    # Shapes.
    "more actions": put(TIP, lambda old: np.concatenate([old, old], 1)),
    "fewer actions": put(WRENCH, lambda old: old[:, :-1]),
    "another window": put(WRENCH, lambda old: old[:, :, :49]),
    "another axis": put(WRENCH, lambda old: old[..., :3]),
    "more rows": put("length", lambda old: np.concatenate([old, old])),
    "fewer rows": put("length", lambda old: old[1:]),
    "no rows": put("length", lambda old: old[:0]),
    "one number": put("length", np.int32(3)),
    "no space": no_space,
    "flat": put(TIP, lambda old: old.ravel()),
    "a dimension more": put("hole_pos_world", lambda old: old[..., None]),
    # What is there.
    "missing": lambda file: file.__delitem__("valid"),
    "missing in the trace": lambda file: file.__delitem__(TIP),
    "without its trace": lambda file: file.__delitem__("trace"),
    "one more": aside,
    "one more in the trace": lambda file: file.__setitem__("trace/more", np.zeros(2)),
    "group for a field": group_for_field,
    "field for a group": field_for_group,
    "linked in a circle": cycle,
    "linked softly": moved,
    "linked to nothing": link("length", h5py.SoftLink("/nowhere")),
    "linked to a file": link("length", h5py.ExternalLink("/etc/hostname", "/length")),
    # How it is stored.
    "lzf": put("end_qpos", lambda old: old, compression="lzf"),
    "checksums": put("end_qpos", lambda old: old, fletcher32=True),
    "lossy": put("length", lambda old: old, scaleoffset=0, chunks=True),
    "packed twice": filtered_twice,
    "never written": empty(WRENCH, (EPISODES, STEPS, 50, 6), compression="gzip"),
    "never written and huge": empty("length", HUGE, compression="gzip"),
    # Numbers.
    "negative length": at("length", 2, -1),
    "too long": at("length", 2, STEPS + 1),
    "policy 999": at("policy", 0, 999),
    "a custom policy that the request lacks": at("policy", 0, 2),
    "policy -1": at("policy", 0, -1),
    "fourth shape": at("peg_type", 5, 3),
    "negative shape": at("hole_type", 5, -1),
    "not a number": at(WRENCH, (0, 0, 0, 0), np.nan),
    "infinite": at("tare_sensor", (1, 0), np.inf),
    "1e30": at(TIP, (1, 0, 0), 1e30),
    "hole nowhere": at("hole_pos_world", (3, 1), np.nan),
    "ids of others": put("episode", np.arange(EPISODES) + 1),
    "ids in another order": put("episode", np.arange(EPISODES)[::-1]),
    "another sequence": at("sequence", 1, 7),
    "another number": at("number", 1, 1),
    "neither true nor false": twos("valid"),
    "neither in the trace": twos("trace/contact"),
}
