"""Tables of results for pandas and others: a row for each metric, or for each trial."""

import json
from pathlib import Path
from typing import Any, Literal

from mjx_fit.evaluation import results
from mjx_fit.utils import files, locks
from mjx_fit.utils.errors import RequestError

try:
    import pandas
except ImportError:
    raise ImportError("tables need pandas, which is not installed: pip install 'mjx-fit[logs]'") from None

Kind = Literal["summary", "trials"]
SUFFIXES = (".csv", ".parquet")


def write_table(inputs: list[Path], out: Path, kind: Kind) -> int:
    """Write rows of result files, one below the other, and return their number.

    Each row names its file, experiment, engine and root seed. A cell that is no number, text or truth value,
    such as the errors after each attempt of a trial, is JSON.

    Args:
        inputs: Result files.
        out: ``.csv`` or ``.parquet``; an existing file is replaced.
        kind: ``summary``: metrics with their intervals; ``trials``.

    Raises:
        RequestError: An input is no result file, or the output has another suffix.
    """
    if out.suffix not in SUFFIXES or out.is_dir():
        raise RequestError(f"--out: {out} is invalid: expected a file that ends in {' or '.join(SUFFIXES)}")
    rows = [row for path in inputs for row in _rows(path, kind)]
    table = pandas.DataFrame(rows)
    for name in table.columns:
        if len({_kind(value) for value in table[name] if not pandas.isna(value)}) > 1:
            table[name] = [
                value if isinstance(value, str) or pandas.isna(value) else json.dumps(value)
                for value in table[name]
            ]

    def write(temporary: Path) -> None:
        if out.suffix == ".csv":
            table.to_csv(temporary, index=False)
        else:
            table.to_parquet(temporary, index=False)

    with locks.holding_file(out):
        files.replace_with(out, write)
    return len(rows)


def _rows(path: Path, kind: Kind) -> list[dict[str, Any]]:
    result = results.read(path)
    about = {
        "file": path.name,
        "experiment": result.experiment,
        "engine": result.engine,
        "root_seed": result.seed,
    }
    rows = [vars(row) for row in result.summary] if kind == "summary" else result.trials
    return [about | {name: _cell(value) for name, value in row.items()} for row in rows]


def _cell(value: Any) -> Any:
    return value if value is None or isinstance(value, str | int | float | bool) else json.dumps(value)


def _kind(value: Any) -> type:
    """Return the type of a cell; a column of a parquet file has one, which holds integers and others."""
    return float if type(value) is int else type(value)
