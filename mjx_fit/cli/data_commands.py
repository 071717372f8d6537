"""Commands ``collect`` and ``data``: simulate, check, merge and convert data sets."""

import argparse
from dataclasses import fields, replace

from mjx_fit.cli.options import (
    SEEK,
    add_command,
    config_of,
    configurable,
    policy_of,
    pool_of,
    simulating,
    with_cluster,
    with_policy,
)
from mjx_fit.cli.output import show
from mjx_fit.cli.path_argument import path, run_path
from mjx_fit.utils.errors import RequestError, WorkError

# Each command imports its own dependencies, so that `mjx-fit --help` answers immediately.


def add_collect(parsers: argparse._SubParsersAction) -> None:
    """Add ``collect``."""
    parser = add_command(parsers, "collect", collect, "simulate episodes and store them", resumes=True)
    parser.add_argument("--out", type=path, required=True, metavar="DIR")
    parser.add_argument("--episodes", type=int, default=3000, metavar="N", help="attempts (default 3000)")
    length = parser.add_mutually_exclusive_group()
    length.add_argument(
        "--actions",
        type=int,
        metavar="J",
        help="most actions in one episode (default: task.attempt_actions, 100)",
    )
    length.add_argument("--steps", dest="actions", type=int, help=argparse.SUPPRESS)  # former name
    with_policy(parser, "spiral, random, mixed, raster, tilt, seek", "spiral")
    parser.add_argument(
        "--batch", type=int, default=250, metavar="B", help="most episodes in one file (default 250)"
    )
    parser.add_argument(
        "--sequence", type=int, default=1, metavar="K", help="consecutive attempts at one hole (default 1)"
    )
    parser.add_argument(
        "--run",
        type=run_path,
        metavar="RUN",
        help="start later attempts from the posterior of this run's sensor (default: from drawn beliefs); "
        "with --policy seek, the sensor that it acts on",
    )
    parser.add_argument(
        "--shard-index", type=int, default=0, metavar="I", help="part of the whole to collect (default 0)"
    )
    parser.add_argument(
        "--num-shards", type=int, default=1, metavar="N", help="number of parts, one for each machine"
    )
    parser.add_argument(
        "--shared-storage",
        action="store_true",
        help="workers of --cluster write shards into DIR themselves (default: they send them to one writer)",
    )
    with_cluster(parser)
    simulating(parser)
    configurable(parser)


def add_data(parsers: argparse._SubParsersAction) -> None:
    """Add ``data info``, ``check``, ``merge`` and ``export``."""
    whats = parsers.add_parser("data", help="describe, check, join or convert data sets").add_subparsers(
        required=True, metavar="WHAT"
    )
    info = add_command(whats, "info", data_info, "describe a data set; pairs are peg-hole")
    info.add_argument("folder", type=path, metavar="DIR")
    info.add_argument("--json", action="store_true")
    check = add_command(whats, "check", data_check, "find every damaged, missing or foreign file")
    check.add_argument("folder", type=path, metavar="DIR")
    merge = add_command(whats, "merge", data_merge, "join parts made with --num-shards", resumes=True)
    merge.add_argument("folders", type=path, nargs="+", metavar="DIR")
    merge.add_argument("--out", type=path, required=True, metavar="DIR")
    export = add_command(whats, "export", data_export, "convert a data set to files of other tools")
    export.add_argument("folder", type=path, metavar="DIR")
    export.add_argument(
        "--out",
        type=path,
        required=True,
        metavar="OUT",
        help=".npz, .hdf5 (robomimic), .mcap (ROS 2, Foxglove), or the name of a folder (LeRobot v3)",
    )


def collect(args: argparse.Namespace) -> None:
    """Run ``collect``."""
    from mjx_fit.data.collect import collect, invalid_in
    from mjx_fit.data.plan import Plan, check
    from mjx_fit.engines.select import make_engine
    from mjx_fit.task.estimator import filter_update
    from mjx_fit.training.sensor_loader import load_trained_sensor

    config, policy = policy_of(args, config_of(args))
    asked = {
        field.name: getattr(args, field.name)
        for field in fields(Plan)
        if field.name not in ("sensor", "turns")
    }
    if args.actions is None:
        asked["actions"] = config.task.attempt_actions
    if policy is not None:
        asked["policy"] = policy.name
    plan, update = Plan(**asked), None
    if args.run is not None and not (args.policy == SEEK and plan.sequence == 1):
        sensor = load_trained_sensor(args.run)
        plan, update = replace(plan, sensor=sensor.fingerprint), filter_update(config, sensor.network)
        check(plan)
        sensor.say_if_away(config, "collect")
    if args.shared_storage and args.cluster is None:
        raise RequestError("--shared-storage: it has no effect without --cluster")
    engine, pool = make_engine(plan.engine, config, policy), pool_of(args, shared=args.shared_storage)
    collect(config, args.out, plan, engine, update, pool)
    part = f" (part {plan.shard_index} of {plan.num_shards})" if plan.num_shards > 1 else ""
    print(f"{args.out}: complete{part}{invalid_in(args.out)}")


def data_info(args: argparse.Namespace) -> None:
    """Run ``data info``."""
    from mjx_fit.data.reader import describe

    show(describe(args.folder), args.json)


def data_check(args: argparse.Namespace) -> None:
    """Run ``data check``."""
    from mjx_fit.data.manifest import MANIFEST_NAME, read_manifest
    from mjx_fit.data.plan import plan_of
    from mjx_fit.data.reader import damages

    found = damages(args.folder)
    for name, what in found.items():
        print(f"{name}: {what}")
    if found:
        raise WorkError(f"{args.folder}: {_what_to_do(found, MANIFEST_NAME)}")
    there = read_manifest(args.folder)
    if there.complete:
        print(f"{args.folder}: complete, all {len(there.shards)} shards whole")
        return
    plan = plan_of(there)
    count = f"{len(there.shards)} of {len(plan.shards())} shards, all whole"
    print(f"{args.folder}: not complete: {count}. Resume with")
    print(plan.command(args.folder), "and its --config and --set, if it had any")


def _what_to_do(found: dict[str, str], manifest: str) -> str:
    lost = sum(not what.startswith("foreign") for what in found.values())
    if manifest in found or not lost:
        return f"{len(found)} wrong"
    return f"{lost} of its shards damaged; rerun its collect command to make them again"


def data_merge(args: argparse.Namespace) -> None:
    """Run ``data merge``."""
    from mjx_fit.data.merge import merge

    merge(args.folders, args.out)
    print(f"{args.out}: complete")


def data_export(args: argparse.Namespace) -> None:
    """Run ``data export``."""
    from mjx_fit.data.exports import export

    try:
        written = export(args.folder, args.out)
    except ImportError as error:
        raise RequestError(str(error)) from None
    print(*written, sep="\n")
