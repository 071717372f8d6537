"""Tables with a column for each number: CSV and parquet."""

import difflib
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from mjx_fit.data.logs.log_map import LogMap
from mjx_fit.data.logs.raw_log import SECONDS, Labels, RawLog, Stream
from mjx_fit.utils.errors import RequestError, shortened, shown

try:
    import pandas
except ImportError:
    raise ImportError(
        "tables of logs need pandas, which is not installed: pip install 'mjx-fit[logs]'"
    ) from None


def read_table(path: Path, asked: LogMap) -> RawLog:
    """Read a table.

    A row may leave out a signal that is slower than others: all its cells are empty then.

    Raises:
        RequestError: The file cannot be read, a column is missing, or a cell is no number.
    """
    columns = {name: _columns(name, source) for name, source in asked.sources.items()}
    wanted = {name for own in columns.values() for name in own}
    table = _read(path)
    for name in sorted(wanted | set(asked.labels.values())):
        _require_column(path, name, table)
    streams = {}
    for name, own in columns.items():
        time = _times(path, table, name, asked)
        values = np.column_stack([_numbers(path, table, column) for column in own])
        there = ~np.isnan(values).all(1)
        streams[name] = Stream(time[there], values[there])
    labels = {}
    for name, own in asked.labels.items():
        values = table[own]
        there = values.notna().to_numpy()
        labels[name] = Labels(_times(path, table, name, asked)[there], values.to_numpy()[there])
    return RawLog(path.name, streams, labels)


def _columns(name: str, source: str | tuple[str, ...]) -> tuple[str, ...]:
    if isinstance(source, str):
        raise RequestError(f"map: {name}.source: {shown(source)} is invalid: expected a list of columns")
    return source


def _read(path: Path) -> Any:
    try:
        if path.suffix == ".parquet":
            return pandas.read_parquet(path)
        return pandas.read_csv(path, low_memory=False, skipinitialspace=True)
    except (OSError, ValueError, pandas.errors.ParserError, pandas.errors.EmptyDataError) as error:
        raise RequestError(f"{path} cannot be read: {shortened(' '.join(str(error).split()), 200)}") from None


def _require_column(path: Path, name: str, table: Any) -> None:
    if name in table.columns:
        return
    near = difflib.get_close_matches(name, [str(column) for column in table.columns], cutoff=0.0)
    raise RequestError(f"{path}: the column {shown(name)} is missing: it has {', '.join(near)} and others")


def _times(path: Path, table: Any, signal: str, asked: LogMap) -> Float[np.ndarray, "N"]:
    own = f"{signal}_time"
    name = own if own in table.columns else asked.time.source
    _require_column(path, name, table)
    return SECONDS[asked.time.unit] * _numbers(path, table, name)


def _numbers(path: Path, table: Any, name: str) -> Float[np.ndarray, "N"]:
    column = table[name]
    numbers: Any = pandas.to_numeric(column, errors="coerce")
    wrong = (numbers.isna() & column.notna()).to_numpy()
    if wrong.any():
        row = int(wrong.argmax())
        raise RequestError(
            f"{path}: {shown(column.iloc[row])} in row {row + 1} of {shown(name)} is invalid: "
            "expected a number"
        )
    return np.asarray(numbers, np.float64)
