"""Commands ``demo``, ``paper``, ``report`` and ``table``: each makes something to read."""

import argparse
from pathlib import Path

from mjx_fit.cli.options import add_command, config_of, configurable, pool_of, with_cluster
from mjx_fit.cli.path_argument import path
from mjx_fit.utils.errors import RequestError


def add_demo(parsers: argparse._SubParsersAction) -> None:
    """Add ``demo``."""
    parser = add_command(
        parsers, "demo", demo, "run assemblies and write a video and a page, in minutes", resumes=True
    )
    parser.add_argument(
        "--out", type=path, metavar="DIR", help="default: runs/demo, or runs/demo-train with --train"
    )
    parser.add_argument(
        "--train",
        action="store_true",
        help="collect a small data set and train on it, instead of using the weights that ship",
    )
    configurable(parser)


def add_paper(parsers: argparse._SubParsersAction) -> None:
    """Add ``paper``."""
    parser = add_command(
        parsers, "paper", paper, "reproduce the paper: data, training, experiments, report", resumes=True
    )
    parser.add_argument("--out", type=path, required=True, metavar="DIR")
    parser.add_argument("--size", default="cpu", help="quick, cpu or full (default cpu)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="root seed (default 0)")
    with_cluster(parser)
    configurable(parser)


def add_report(parsers: argparse._SubParsersAction) -> None:
    """Add ``report``."""
    parser = add_command(parsers, "report", report, "write one page from results, videos, runs and data sets")
    parser.add_argument("inputs", type=path, nargs="+", metavar="FILE|DIR")
    parser.add_argument("--out", type=path, metavar="DIR", help="default: report in the first input's folder")


def add_table(parsers: argparse._SubParsersAction) -> None:
    """Add ``table``."""
    parser = add_command(parsers, "table", table, "write results as one table for pandas: CSV or parquet")
    parser.add_argument("results", type=path, nargs="+", metavar="RESULT.json")
    parser.add_argument("--out", type=path, required=True, metavar="FILE", help=".csv or .parquet")
    parser.add_argument(
        "--rows",
        choices=("summary", "trials"),
        default="summary",
        help="metrics with their intervals, or trials (default summary)",
    )


def demo(args: argparse.Namespace) -> None:
    """Run ``demo``."""
    from mjx_fit.cli.demo import Size, run_demo

    out = args.out or Path("runs", "demo-train" if args.train else "demo")
    run_demo(config_of(args, preset="quick" if args.train else "demo"), out, Size(), args.train)


def paper(args: argparse.Namespace) -> None:
    """Run ``paper``."""
    from mjx_fit.cli.paper import run_paper, size_of

    size = size_of(args.size)
    run_paper(config_of(args, preset=size.preset), args.out, size, args.seed, pool_of(args))


def report(args: argparse.Namespace) -> None:
    """Run ``report``."""
    from mjx_fit.report.build import beside, build

    print(build(args.inputs, args.out or beside(args.inputs[0])))


def table(args: argparse.Namespace) -> None:
    """Run ``table``."""
    try:
        from mjx_fit.report.tables import write_table
    except ImportError as error:
        raise RequestError(str(error)) from None
    count = write_table(args.results, args.out, args.rows)
    print(f"{args.out}: {count} rows")
