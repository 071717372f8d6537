"""A flat dictionary of arrays in a folder: Orbax writes it, as Zarr arrays in one key-value store.

It is read straight from that store, one array after the other: what is damaged ends in one error, where
Orbax's tasks leave tracebacks of their own.
"""

from pathlib import Path
from typing import Any

import numpy as np
import orbax.checkpoint as ocp
import tensorstore as ts

Arrays = dict[str, np.ndarray]

LARGEST, MOST = 2**34, 100_000
"""Bytes of all arrays together, and how many there may be."""
_HEADER = "/.zarray"


def write(folder: Path, arrays: Arrays) -> None:
    """Stores the arrays in a new folder; of where that is, nothing is left in it."""
    with ocp.PyTreeCheckpointer(use_ocdbt=True, use_zarr3=False) as checkpointer:
        checkpointer.save(folder.absolute(), arrays)
    (folder / "commit_success.txt").unlink(missing_ok=True)  # it says where it was written


def read(folder: Path) -> Arrays:
    """The arrays of a folder.

    Raises:
        ValueError: It holds none, or they cannot be read, or are larger than any of ours.
    """
    try:
        return _read(folder)
    except ValueError:
        raise
    except Exception as error:  # the store raises whatever it likes
        raise ValueError(" ".join(str(error).split())[:120]) from None


def _read(folder: Path) -> Arrays:
    store = {"driver": "ocdbt", "base": {"driver": "file", "path": f"{folder.absolute()}/"}}
    keys = [key.decode() for key in ts.KvStore.open(store).result().list().result()]
    names = [key.removesuffix(_HEADER) for key in keys if key.endswith(_HEADER)]
    if not 0 < len(names) <= MOST:
        raise ValueError(f"it holds {len(names)} arrays")
    arrays = {name: _open(store | {"path": f"{name}/"}) for name in names}
    if sum(array.size * array.dtype.numpy_dtype.itemsize for array in arrays.values()) > LARGEST:
        raise ValueError(f"its arrays have more than {LARGEST:,} bytes")
    return {name: np.asarray(array.read().result()) for name, array in arrays.items()}


def _open(store: dict[str, Any]) -> Any:
    """An array that is there, not read yet."""
    array = ts.open({"driver": "zarr", "kvstore": store}, open=True, read=True, write=False).result()
    if array.dtype.numpy_dtype.kind not in "fiub":
        raise ValueError(f"{store['path']} holds {array.dtype.name}")
    return array
