"""Readers of logs, one for each kind of file; ``read_raw`` chooses."""

from pathlib import Path

from mjx_fit.data.logs.log_map import LogMap
from mjx_fit.data.logs.raw_log import RawLog
from mjx_fit.utils.errors import RequestError, shown

SUFFIXES = (".csv", ".npz", ".parquet", ".bag", ".mcap", ".db3")


def read_raw(path: Path, asked: LogMap) -> RawLog:
    """Read the signals of a log that a map asks for.

    Args:
        path: ``.csv``, ``.npz``, ``.parquet``, ``.bag``, ``.mcap``, or the folder of a rosbag2 or of a
            LeRobot data set.
        asked: The map.

    Raises:
        RequestError: The file cannot be read, or lacks a signal.
    """
    if not path.exists():
        raise RequestError(f"{path} cannot be read: it does not exist")
    if (path / "meta" / "info.json").exists():
        from mjx_fit.data.logs.sources.lerobot import read_lerobot

        return read_lerobot(path, asked)
    if path.is_dir() or path.suffix in (".bag", ".mcap", ".db3"):
        from mjx_fit.data.logs.sources.bags import read_bag

        return read_bag(path, asked)
    if path.suffix in (".csv", ".parquet"):
        from mjx_fit.data.logs.sources.tables import read_table

        return read_table(path, asked)
    if path.suffix == ".npz":
        from mjx_fit.data.logs.sources.arrays import read_arrays

        return read_arrays(path, asked)
    raise RequestError(
        f"{path}: {shown(path.suffix)} is invalid: expected {', '.join(SUFFIXES)}, or the folder of a "
        "rosbag2 or of LeRobot"
    )
