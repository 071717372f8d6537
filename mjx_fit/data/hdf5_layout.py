"""How a shard must lie in its file: checked before a number of it is read.

A digest says that a file is the one that was written, not who wrote it. HDF5 can name other files, run
filters, hold objects and declare terabytes; a shard does none of that.
"""

from collections.abc import Iterator
from typing import Any

import h5py
import numpy as np
from h5py import h5d, h5l, h5t, h5z  # pyright: ignore[reportAttributeAccessIssue]

Shape = tuple[int, ...]

_OTHER_TYPES = {
    **dict.fromkeys(("episode", "sequence", "number"), np.int64),
    **dict.fromkeys(("policy", "length", "peg_type", "hole_type"), np.int32),
    **dict.fromkeys(("inserted", "valid", "trace/contact"), np.bool_),
}
"""Types of the fields that are no single floats."""

_INFLATION = 1100
"""Bytes that one byte can unpack to, at most: deflate ends at 1032."""
_SMALL = 4096


class LayoutError(ValueError):
    """The file holds something else than a shard, or something more."""


def type_of(name: str) -> np.dtype:
    """The type in which a field is stored."""
    return np.dtype(_OTHER_TYPES.get(name, np.float32))


def require(file: h5py.File, shapes: dict[str, Shape], file_bytes: int) -> None:
    """Make sure that a file holds these fields as plain data inside itself, and nothing else.

    Args:
        file: Opened, read from memory.
        shapes: The shape of each field, by its path.
        file_bytes: Size of the file: what it says that it holds must fit into it, packed.

    Raises:
        LayoutError: It does not; the message names the field.
    """
    declared = 0
    for name, dataset in _datasets(file, set(shapes)):
        declared += _require_plain(name, dataset, shapes[name])
    if declared > _INFLATION * file_bytes + _SMALL:
        raise LayoutError(f"it says that it holds {declared:,} bytes, more than can be packed into it")


def _datasets(file: h5py.File, names: set[str]) -> Iterator[tuple[str, Any]]:
    """What is in the places of the fields, by their paths, each reached through hard links alone."""
    groups = {name.rpartition("/")[0] for name in names}
    for place in sorted(groups):
        group = file[place] if place else file
        inside = {name.rpartition("/")[2] for name in names if name.rpartition("/")[0] == place}
        inside |= {one for one in groups if one and not place}
        if not isinstance(group, h5py.Group):
            raise LayoutError(f"{place}: expected a group")
        if len(group) != len(inside) or set(group) != inside:
            found = sorted(set(group) ^ inside) if len(group) < 10 * len(inside) else ["many more"]
            raise LayoutError(f"{place or 'it'}: expected its fields and nothing else: {found[0]!a}"[:200])
        for name in sorted(inside):
            path = f"{place}/{name}".removeprefix("/")
            if group.id.links.get_info(name.encode()).type != h5l.TYPE_HARD:
                raise LayoutError(f"{path}: links are not supported")
            if path in names:
                yield path, group[name]


def _require_plain(name: str, dataset: Any, shape: Shape) -> int:
    """The bytes of a field, if it is an array of the type and shape that it must be, in the file."""
    if not isinstance(dataset, h5py.Dataset):
        raise LayoutError(f"{name}: expected a data set")
    settings = dataset.id.get_create_plist()
    if settings.get_layout() not in (h5d.CONTIGUOUS, h5d.CHUNKED) or settings.get_external_count():
        raise LayoutError(f"{name}: external and virtual data are not supported")
    filters = [settings.get_filter(i)[0] for i in range(settings.get_nfilters())]
    if len(set(filters)) < len(filters) or set(filters) - {h5z.FILTER_DEFLATE, h5z.FILTER_SHUFFLE}:
        raise LayoutError(f"{name}: the filters {filters} are invalid: expected gzip and shuffle")
    wanted, found = type_of(name), dataset.id.get_type()
    if not found.equal(h5t.py_create(wanted, logical=True)):
        raise LayoutError(f"{name}: its type is {_type_name(found)}: expected {wanted}")
    if dataset.id.shape != shape:
        raise LayoutError(f"{name}: its shape is {dataset.id.shape}: expected {shape}")
    size, stored = int(np.prod(shape, dtype=np.int64)) * wanted.itemsize, dataset.id.get_storage_size()
    if size > _INFLATION * stored + _SMALL or not stored:
        raise LayoutError(f"{name}: {stored} bytes are stored of {size:,}")
    return size


def _type_name(found: h5t.TypeID) -> str:
    """What a type is called in an error; NumPy's name, where it has one."""
    if found.get_class() in (h5t.INTEGER, h5t.FLOAT):
        return str(found.dtype)
    kinds = {
        h5t.STRING: "text",
        h5t.VLEN: "variable-length",
        h5t.COMPOUND: "compound",
        h5t.ENUM: "an enumeration",
    }
    return kinds.get(found.get_class(), "another one")
