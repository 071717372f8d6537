"""Arrays in an npz file: ``wrench`` (N, 6), ``pose`` (M, 7), and their times."""

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mjx_fit.data.logs.log_map import LogMap, Source
from mjx_fit.data.logs.raw_log import SECONDS, Labels, RawLog, Stream
from mjx_fit.utils.errors import RequestError, shown


def read_arrays(path: Path, asked: LogMap) -> RawLog:
    """Read an npz file; a source is an array (N, k), or k arrays (N,).

    Raises:
        RequestError: The file cannot be read, or an array is missing, of another shape, or not of numbers.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            found = dict(file)
    except (OSError, ValueError, zipfile.BadZipFile, EOFError) as error:
        raise RequestError(f"{path} cannot be read: {error}") from None
    except Exception as error:  # zlib.error and others of damaged files
        raise RequestError(f"{path} cannot be read: it is damaged ({type(error).__name__})") from None
    streams = {}
    for name, source in asked.sources.items():
        values = _values(path, found, source)
        streams[name] = Stream(_times(path, found, name, asked, len(values)), values)
    labels = {}
    for name, source in asked.labels.items():
        values = _array(path, found, source)
        labels[name] = Labels(_times(path, found, name, asked, len(values)), values)
    return RawLog(path.name, streams, labels)


def _values(path: Path, found: Mapping[str, np.ndarray], source: Source) -> np.ndarray[Any, Any]:
    if isinstance(source, str):
        values = _numbers(path, found, source)
        if values.ndim != 2:
            raise RequestError(f"{path}: {source}: shape {values.shape} is invalid: expected (N, k)")
        return values
    columns = [_numbers(path, found, name) for name in source]
    for name, column in zip(source, columns, strict=True):
        if column.shape != columns[0].shape or column.ndim != 1:
            raise RequestError(f"{path}: {name}: shape {column.shape} is invalid: expected (N,) as others")
    return np.column_stack(columns)


def _times(
    path: Path, found: Mapping[str, np.ndarray], signal: str, asked: LogMap, count: int
) -> np.ndarray[Any, Any]:
    own = f"{signal}_time"
    name = own if own in found else asked.time.source
    time = _numbers(path, found, name)
    if time.shape != (count,):
        raise RequestError(f"{path}: {name}: shape {time.shape} is invalid: expected ({count},)")
    return SECONDS[asked.time.unit] * time


def _numbers(path: Path, found: Mapping[str, np.ndarray], name: str) -> np.ndarray[Any, Any]:
    array = _array(path, found, name)
    if not np.issubdtype(array.dtype, np.number) or np.iscomplexobj(array):
        raise RequestError(f"{path}: {name}: {array.dtype} is invalid: expected numbers")
    return array.astype(float)


def _array(path: Path, found: Mapping[str, np.ndarray], name: str) -> np.ndarray[Any, Any]:
    if name not in found:
        raise RequestError(f"{path}: the array {shown(name)} is missing: it has {', '.join(sorted(found))}")
    return found[name]
