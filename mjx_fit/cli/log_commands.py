"""Commands ``log check`` and ``log import``: logs of real robots, what is wrong with them, and data sets."""

import argparse
from typing import TYPE_CHECKING

from mjx_fit.cli.options import add_command, config_of, with_config
from mjx_fit.cli.path_argument import path
from mjx_fit.utils.errors import RequestError, WorkError

if TYPE_CHECKING:
    from mjx_fit.config.schema import Config
    from mjx_fit.data.logs.importing import ImportedLog

# Each command imports its own dependencies, so that `mjx-fit --help` answers immediately.


def add_log(parsers: argparse._SubParsersAction) -> None:
    """Add ``log check`` and ``log import``."""
    whats = parsers.add_parser("log", help="read logs of real robots").add_subparsers(
        required=True, metavar="WHAT"
    )
    check = add_command(whats, "check", log_check, "say what is wrong with logs, and list their attempts")
    read = add_command(whats, "import", log_import, "write the attempts of logs as a data set", resumes=True)
    for parser in (check, read):
        parser.add_argument(
            "files",
            type=path,
            nargs="+",
            metavar="FILE",
            help=".csv, .npz, .parquet, .bag, .mcap, or the folder of a rosbag2",
        )
        parser.add_argument(
            "--map",
            type=path,
            required=True,
            metavar="MAP.yaml",
            help="topics or columns, units, frames, signs",
        )
        with_config(parser)
    read.add_argument("--out", type=path, required=True, metavar="DIR", help="folder of the data set")


def log_check(args: argparse.Namespace) -> None:
    """Run ``log check``."""
    logs = _read(args, config_of(args))
    for log in logs:
        for line in _described(log):
            print(f"{log.name}: {line}")
    refused = [log.name for log in logs if log.refused]
    if refused:
        raise WorkError(f"{', '.join(refused)}: cannot be used: see above")


def log_import(args: argparse.Namespace) -> None:
    """Run ``log import``."""
    config = config_of(args)
    logs = _read(args, config)
    from mjx_fit.data.logs.dataset import write_logs

    count = write_logs(logs, args.files, config, args.out)
    for log in logs:
        for finding in log.findings:
            print(f"{log.name}: {finding}")
    print(f"{args.out}: complete, {count} attempts of {len(logs)} logs")


def _read(args: argparse.Namespace, config: "Config") -> "list[ImportedLog]":
    try:
        from mjx_fit.data.logs import import_log, read_map

        said = read_map(args.map)
        return [import_log(file, said, config) for file in args.files]
    except ImportError as error:
        raise RequestError(str(error)) from None


def _described(log: "ImportedLog") -> list[str]:
    """Return lines about a log: what is wrong with it, and its attempts."""
    import numpy as np

    lines = [str(finding) for finding in log.findings]
    for one in log.attempts:
        force = np.linalg.norm(one.felt.trace.wrench_sensor[..., :3] - one.felt.tare_sensor[:3], axis=-1)
        x, y = one.felt.estimate_world[:2]
        lines.append(
            f"attempt {one.name}: {one.begin_s:.3f} to {one.end_s:.3f} s, from ({x:.4f}, {y:.4f}) m, "
            f"largest force {force.max():.1f} N"
        )
    return [*lines, f"{len(log.attempts)} attempts can be used"]
