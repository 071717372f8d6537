"""Commands ``evaluate``: experiments, each with one result file."""

import argparse
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from mjx_fit.cli.options import (
    RUN,
    SEEK,
    add_command,
    config_of,
    configurable,
    policy_of,
    pool_of,
    run_of,
    simulating,
    with_cluster,
    with_policy,
)
from mjx_fit.cli.path_argument import path, run_path
from mjx_fit.utils.errors import RequestError, shown

if TYPE_CHECKING:
    from mjx_fit.evaluation.request import Request
    from mjx_fit.evaluation.results import Result

Commands = argparse._SubParsersAction


def add_evaluate(parsers: Commands) -> None:
    """Add all experiments."""
    commands = parsers.add_parser("evaluate", help="run an experiment").add_subparsers(
        required=True, metavar="EXPERIMENT"
    )
    _add_attempt(commands)
    _add_assembly(commands)
    _add_position(commands)
    _add_insertion(commands)
    _add_robustness(commands)
    _add_calibration(commands)


def _add_attempt(commands: Commands) -> None:
    parser = add_command(
        commands, "attempt", attempt, "measure the success rate of single attempts", resumes=True
    )
    parser.add_argument("--run", type=run_path, metavar="RUN", help=f"{RUN}; for --policy {SEEK} alone")
    _with_trials(parser, 100, "matched attempts for each shape, and mismatched ones in all")


def _add_assembly(commands: Commands) -> None:
    parser = add_command(commands, "assembly", assembly, "run assemblies under several methods", resumes=True)
    _with_methods(parser, "failure_only,failure_position,full,oracle")
    _with_trials(parser, 100, "assemblies under each method")


def _add_position(commands: Commands) -> None:
    parser = add_command(
        commands,
        "position",
        position,
        "measure the position error over repeated attempts at one hole",
        resumes=True,
    )
    _with_methods(parser, "full,frame_by_frame,oracle")
    _with_trials(parser, 100, "mismatched holes, and as many matched ones")


def _add_insertion(commands: Commands) -> None:
    parser = add_command(
        commands,
        "insertion",
        insertion,
        "measure the insertion rate over repeated attempts at one hole",
        resumes=True,
    )
    _with_methods(parser, "full,no_update,sample,frame_by_frame,oracle")
    parser.add_argument(
        "--seeds",
        type=int,
        default=5,
        metavar="K",
        help="seeds of the exploration noise for each draw (default 5)",
    )
    _with_trials(parser, 150, "draws of a hole and its detection")


def _add_robustness(commands: Commands) -> None:
    parser = add_command(
        commands,
        "robustness",
        robustness,
        "measure error and calibration under perturbed physics and readings",
        resumes=True,
    )
    parser.add_argument("--run", type=run_path, metavar="RUN", help=RUN)
    parser.add_argument("--out", type=path, required=True, metavar="FILE.json")
    parser.add_argument(
        "--trials",
        type=int,
        default=500,
        metavar="N",
        help="mismatched holes under each perturbation, and half as many matching ones (default 500)",
    )
    parser.add_argument("--perturbations", metavar="A,B", help="names (default: all; see the guide)")
    _with_parts(parser)
    simulating(parser)
    configurable(parser)


def _add_calibration(commands: Commands) -> None:
    parser = add_command(
        commands, "calibration", calibration, "measure the calibration of a trained sensor on a data set"
    )
    parser.add_argument("--run", type=run_path, metavar="RUN", help=RUN)
    parser.add_argument(
        "--data", type=path, required=True, metavar="DIR", help="a data set that it was not trained on"
    )
    parser.add_argument("--out", type=path, required=True, metavar="FILE.json")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="root seed of the noise (default 0)")
    configurable(parser)


def _with_methods(parser: argparse.ArgumentParser, methods: str) -> None:
    parser.add_argument("--run", type=run_path, metavar="RUN", help=RUN)
    parser.add_argument("--methods", default=methods, metavar="A,B", help="default: %(default)s")


def _with_trials(parser: argparse.ArgumentParser, count: int, what: str) -> None:
    parser.add_argument("--out", type=path, required=True, metavar="FILE.json")
    parser.add_argument("--trials", type=int, default=count, metavar="N", help=f"{what} (default {count})")
    with_policy(parser, "spiral, raster, tilt, seek", None)
    _with_parts(parser)
    simulating(parser)
    configurable(parser)


def _with_parts(parser: argparse.ArgumentParser) -> None:
    """Add the cluster, and the size of the parts that it works on."""
    with_cluster(parser)
    parser.add_argument(
        "--part-rows",
        type=int,
        metavar="N",
        help="most trials times methods in a part, which one worker does at a time and a stopped command "
        "repeats (default: 1024, 256 attempts, 16384 on an accelerator, 128 with --cluster)",
    )


def attempt(args: argparse.Namespace) -> None:
    """Run ``evaluate attempt``."""
    from mjx_fit.evaluation.attempt import attempt

    if args.run is not None and args.policy != SEEK:
        raise RequestError(f"--run: {args.run} has no effect without --policy {SEEK}")
    _evaluate(attempt, args)


def position(args: argparse.Namespace) -> None:
    """Run ``evaluate position``."""
    from mjx_fit.evaluation.position import position

    _evaluate(position, args)


def insertion(args: argparse.Namespace) -> None:
    """Run ``evaluate insertion``."""
    from mjx_fit.evaluation.insertion import insertion

    _evaluate(insertion, args)


def assembly(args: argparse.Namespace) -> None:
    """Run ``evaluate assembly``."""
    from mjx_fit.evaluation.assembly import assembly

    _evaluate(assembly, args)


def _evaluate(experiment: "Callable[[Request], Result]", args: argparse.Namespace) -> None:
    """Run an experiment, with a sensor if it takes ``--run``, and print its summary."""
    from mjx_fit.engines.select import make_engine
    from mjx_fit.evaluation.request import Request
    from mjx_fit.report.terminal import print_summary

    config, policy = policy_of(args, config_of(args))
    if policy is None and args.policy not in (None, "spiral"):
        raise RequestError(
            f"--policy: {shown(args.policy)} is invalid: choose spiral, raster, tilt, seek or FILE.py:NAME"
        )
    engine = make_engine(args.engine, config, policy)
    request = Request(
        config, args.out, engine, args.trials, args.seed, pool=pool_of(args), part_rows=args.part_rows
    )
    if hasattr(args, "methods"):
        request = replace(request, methods=args.methods, seeds=getattr(args, "seeds", 1))
        request = request.with_sensors_of(run_of(args))
    print_summary(experiment(request))


def robustness(args: argparse.Namespace) -> None:
    """Run ``evaluate robustness``."""
    from mjx_fit.engines.select import make_engine
    from mjx_fit.evaluation.perturbations import PERTURBATIONS
    from mjx_fit.evaluation.request import Request
    from mjx_fit.evaluation.robustness import robustness
    from mjx_fit.report.terminal import print_summary

    config = config_of(args)
    engine = make_engine(args.engine, config)
    request = Request(
        config, args.out, engine, args.trials, args.seed, pool=pool_of(args), part_rows=args.part_rows
    )
    request = request.with_sensors_of(run_of(args))
    print_summary(robustness(request, args.perturbations or ",".join(PERTURBATIONS)))


def calibration(args: argparse.Namespace) -> None:
    """Run ``evaluate calibration``."""
    from mjx_fit.evaluation.calibration import calibrate
    from mjx_fit.report.terminal import print_summary

    print_summary(calibrate(config_of(args), args.out, run_of(args), args.data, args.seed))
