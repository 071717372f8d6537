"""Command ``sweep``: an experiment over settings and seeds."""

import argparse
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from mjx_fit.cli.options import (
    RUN,
    add_command,
    config_paths,
    configurable,
    policy_of,
    pool_of,
    run_of,
    with_cluster,
    with_policy,
)
from mjx_fit.cli.path_argument import path, run_path
from mjx_fit.utils.errors import RequestError

if TYPE_CHECKING:
    from mjx_fit.config.schema import Config
    from mjx_fit.engines.interface import Engine


def add_sweep(parsers: argparse._SubParsersAction) -> None:
    """Add ``sweep``."""
    parser = add_command(
        parsers,
        "sweep",
        sweep,
        "run an experiment over settings and seeds: --config names a file with a section sweep",
        resumes=True,
    )
    parser.add_argument(
        "--out", type=path, required=True, metavar="DIR", help="folder of sweep.json and sweep.png"
    )
    parser.add_argument("--run", type=run_path, metavar="RUN", help=RUN)
    parser.add_argument("--engine", default="auto", help="auto, mjx or native (default auto)")
    with_policy(parser, "spiral, raster, tilt, seek", None)
    with_cluster(parser)
    configurable(parser)


def sweep(args: argparse.Namespace) -> None:
    """Run ``sweep``."""
    from mjx_fit.config.sweep_file import read_sweep
    from mjx_fit.evaluation.request import Request
    from mjx_fit.evaluation.sweep import EngineOf, main_rows, sweep
    from mjx_fit.report import script
    from mjx_fit.report.figures.sweep import of_sweep
    from mjx_fit.report.terminal import print_summary

    pool = pool_of(args)
    asked = read_sweep(config_paths(args), args.set)
    if args.out.is_file():
        raise RequestError(f"--out: {args.out} is invalid: expected a folder")
    engine_of = EngineOf(partial(_engine_of, args))
    _, engine = engine_of(asked.base)
    request = Request(asked.base, args.out / "sweep.json", engine, asked.plan.trials, pool=pool)
    if asked.plan.methods:
        request = request.with_sensors_of(run_of(args))
    result = sweep(asked, request, engine_of)
    print_summary(replace(result, summary=main_rows(result)))
    script.draw(args.out / "sweep.png", partial(of_sweep, result))


def _engine_of(args: argparse.Namespace, config: "Config") -> "tuple[Config, Engine]":
    from mjx_fit.engines.select import make_engine

    config, policy = policy_of(args, config)
    return config, make_engine(args.engine, config, policy)
