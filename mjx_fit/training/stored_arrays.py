"""Store a flat dictionary of arrays in a folder; Orbax writes Zarr arrays into one key-value store.

The reader accesses that store directly, one array at a time, so damage raises a single error instead of
tracebacks from Orbax's tasks.
"""

from pathlib import Path
from typing import Any

import numpy as np
import orbax.checkpoint as ocp
import tensorstore as ts

Arrays = dict[str, np.ndarray]

LARGEST, MOST = 2**34, 100_000
"""Maximum total size of the arrays, bytes, and maximum number of arrays."""
_HEADER = "/.zarray"


def write(folder: Path, arrays: Arrays) -> None:
    """Store the arrays in a new folder, without a record of its location."""
    with ocp.PyTreeCheckpointer(use_ocdbt=True, use_zarr3=False) as checkpointer:
        checkpointer.save(folder.absolute(), arrays)
    (folder / "commit_success.txt").unlink(missing_ok=True)  # it contains the path


def read(folder: Path) -> Arrays:
    """Read the arrays of a folder.

    Raises:
        ValueError: The folder holds no arrays, or they are unreadable or too large.
    """
    try:
        return _read(folder)
    except ValueError:
        raise
    except Exception as error:  # the store raises many types
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
    """Open an existing array without reading it."""
    array = ts.open({"driver": "zarr", "kvstore": store}, open=True, read=True, write=False).result()
    if array.dtype.numpy_dtype.kind not in "fiub":
        raise ValueError(f"{store['path']} has the unsupported type {array.dtype.name}")
    return array
