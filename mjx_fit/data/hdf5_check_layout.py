"""Check the layout of a shard file before reading data from it.

A digest proves that a file is unchanged, not who wrote it. HDF5 files can refer to other files, run filters,
contain objects and declare terabytes; shards do none of this.
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
"""Types of the fields that are not single-precision floats."""

_INFLATION = 1100
"""Bound on the compression ratio; deflate reaches at most 1032."""
_SMALL = 4096


class LayoutError(ValueError):
    """The file is not a shard, or contains more than a shard."""


def type_of(name: str) -> np.dtype:
    """Return the type in which a field is stored."""
    return np.dtype(_OTHER_TYPES.get(name, np.float32))


def require(file: h5py.File, shapes: dict[str, Shape], file_bytes: int) -> None:
    """Check that a file contains these fields as plain data of its own, and nothing else.

    Args:
        file: Open file, in memory.
        shapes: Shape of each field, by path.
        file_bytes: Size of the file, which bounds the declared size of the uncompressed data.

    Raises:
        LayoutError: The layout differs; the message names the field.
    """
    declared = 0
    for name, dataset in _datasets(file, set(shapes)):
        declared += _require_plain(name, dataset, shapes[name])
    if declared > _INFLATION * file_bytes + _SMALL:
        raise LayoutError(f"it declares {declared:,} bytes, more than a file of its size can hold")


def _datasets(file: h5py.File, names: set[str]) -> Iterator[tuple[str, Any]]:
    """Iterate over the objects at the paths of the fields, reached through hard links only."""
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
    """Check that a field is an array in the file, of the right type and shape; return its size in bytes."""
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
        raise LayoutError(f"{name}: only {stored} bytes are stored for {size:,} bytes of data")
    return size


def _type_name(found: h5t.TypeID) -> str:
    """Name a type for an error message, by its NumPy name if it has one."""
    if found.get_class() in (h5t.INTEGER, h5t.FLOAT):
        return str(found.dtype)
    kinds = {
        h5t.STRING: "text",
        h5t.VLEN: "variable-length",
        h5t.COMPOUND: "compound",
        h5t.ENUM: "enumeration",
    }
    return kinds.get(found.get_class(), "unknown")
