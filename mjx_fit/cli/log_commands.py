"""Command ``log check``: what is wrong with the log of a robot, and which attempts it holds."""

import argparse
from typing import TYPE_CHECKING

from mjx_fit.cli.options import add_command, config_of, configurable
from mjx_fit.cli.path_argument import path
from mjx_fit.utils.errors import RequestError, WorkError

if TYPE_CHECKING:
    from mjx_fit.data.logs.importing import ImportedLog

# Each command imports its own dependencies, so that `mjx-fit --help` answers immediately.


def add_log(parsers: argparse._SubParsersAction) -> None:
    """Add ``log check``."""
    whats = parsers.add_parser("log", help="read logs of real robots").add_subparsers(
        required=True, metavar="WHAT"
    )
    check = add_command(whats, "check", log_check, "say what is wrong with logs, and list their attempts")
    check.add_argument(
        "files",
        type=path,
        nargs="+",
        metavar="FILE",
        help=".csv, .npz, .parquet, .bag, .mcap, or the folder of a rosbag2",
    )
    check.add_argument(
        "--map", type=path, required=True, metavar="MAP.yaml", help="topics or columns, units, frames, signs"
    )
    configurable(check)


def log_check(args: argparse.Namespace) -> None:
    """Run ``log check``."""
    from mjx_fit.data.logs.log_map import read_map

    config, said = config_of(args), read_map(args.map)
    try:
        from mjx_fit.data.logs.importing import import_log

        logs = [import_log(file, said, config) for file in args.files]
    except ImportError as error:
        raise RequestError(str(error)) from None
    for log in logs:
        for line in _described(log):
            print(f"{log.name}: {line}")
    refused = [log.name for log in logs if log.refused]
    if refused:
        raise WorkError(f"{', '.join(refused)}: cannot be used: see above")


def _described(log: "ImportedLog") -> list[str]:
    """Return lines about a log: what is wrong with it, and its attempts."""
    import numpy as np

    lines = [str(finding) for finding in log.findings]
    for number, one in enumerate(log.attempts):
        force = np.linalg.norm(one.felt.trace.wrench_sensor[..., :3] - one.felt.tare_sensor[:3], axis=-1)
        label = f"attempt {number}" if one.label is None else f"attempt {one.label}"
        x, y = one.felt.estimate_world[:2]
        lines.append(
            f"{label}: {one.begin_s:.3f} to {one.end_s:.3f} s, from ({x:.4f}, {y:.4f}) m, largest force "
            f"{force.max():.1f} N"
        )
    return [*lines, f"{len(log.attempts)} attempts can be used"]
