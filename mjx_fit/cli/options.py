"""Declare and read the options that several commands share."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from mjx_fit.cli.path_argument import path
from mjx_fit.config.files import read_config
from mjx_fit.config.part_sets import PART_SETS, parts_file
from mjx_fit.config.schema import Config
from mjx_fit.config.worlds import WORLDS, world_file
from mjx_fit.utils.errors import RequestError, shortened

if TYPE_CHECKING:
    from mjx_fit.control.policies import Policy
    from mjx_fit.jobs.pool import Pool

RUN = "folder of a training run, as-2026-11, gentle or nist (default: the weights that ship with the package)"
RASTER, TILT, SEEK, SEEK_RUN = "raster", "tilt", "seek", "gentle"
"""Names of the policies ``control.search.raster_search``, ``control.leaning`` and ``task.seek``, and of the
weights and the preset that the latter uses by default."""
_POLICY_FILE = "FILE.py:NAME, a mjx_fit.Policy or a function of PolicyInput"


class Parser(argparse.ArgumentParser):
    """Parser with one-line errors and without abbreviations: --trial and --trials are different options."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs, allow_abbrev=False)

    def error(self, message: str) -> NoReturn:
        raise RequestError(f"{shortened(message, 300)}; see {self.prog} --help")


def add_command(
    parsers: argparse._SubParsersAction,
    name: str,
    run: Callable[[argparse.Namespace], None],
    text: str,
    *,
    resumes: bool = False,
) -> argparse.ArgumentParser:
    """Add a command.

    Args:
        parsers: Subparsers to add it to.
        name: Name of the command.
        run: Function that runs it.
        text: Sentence that describes it, without capital letter and full stop.
        resumes: True if it keeps finished work when it is stopped.
    """
    parser = parsers.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
    parser.set_defaults(command=run, computes=False, draws=False, resumes=resumes, threads=None)
    return parser


def simulating(parser: argparse.ArgumentParser) -> None:
    """Add engine and seed."""
    parser.add_argument("--engine", default="auto", help="auto, mjx or native (default auto)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="root seed (default 0)")


def configurable(parser: argparse.ArgumentParser) -> None:
    """Add threads and the configuration; mark the command as one that computes."""
    parser.set_defaults(computes=True)
    parser.add_argument(
        "--threads",
        type=int,
        metavar="N",
        help="maximum number of CPU threads (default: all that are granted)",
    )
    with_config(parser)


def with_cluster(parser: argparse.ArgumentParser) -> None:
    """Add the cluster that performs the parts of a command."""
    parser.add_argument(
        "--cluster",
        metavar="auto|HOST:PORT",
        help="let workers of a Ray cluster do the work: pip install 'mjx-fit[ray]' (default: this process)",
    )
    parser.add_argument(
        "--worker-cpus",
        type=int,
        default=1,
        metavar="N",
        help="CPUs of each worker of the cluster (default 1)",
    )


def pool_of(args: argparse.Namespace, *, shared: bool = False) -> "Pool":
    """Return what performs the parts of a command.

    Args:
        args: Command line.
        shared: Whether workers write to storage that they share with this process.

    Raises:
        RequestError: Ray is missing, no cluster answers, or the number of CPUs is invalid.
    """
    from mjx_fit.engines.requests import MOST_THREADS
    from mjx_fit.jobs.pool import Here
    from mjx_fit.utils.errors import require

    require("--worker-cpus", args.worker_cpus, 1, MOST_THREADS)
    if args.cluster is None:
        return Here()
    try:
        from mjx_fit.jobs.ray_pool import RayPool
    except ImportError as error:
        raise RequestError(str(error)) from None
    return RayPool(args.cluster, args.worker_cpus, shared=shared)


def with_policy(parser: argparse.ArgumentParser, names: str, default: str | None) -> None:
    """Add the policy: one of these names, or a policy in a file."""
    parser.add_argument(
        "--policy", default=default, metavar="P", help=f"{names}, or {_POLICY_FILE} (default: spiral)"
    )


def with_config(parser: argparse.ArgumentParser) -> None:
    """Add the world, the parts and the configuration."""
    parser.add_argument(
        "--world",
        metavar="NAME",
        help="preset of the physics and the measurements: " + ", ".join(WORLDS) + f" (default {WORLDS[0]})",
    )
    parser.add_argument(
        "--parts",
        metavar="NAME|FILE.yaml",
        help="parts of the scene: " + ", ".join(PART_SETS) + f", or a file (default {PART_SETS[0]})",
    )
    parser.add_argument(
        "--config",
        type=path,
        action="append",
        default=[],
        metavar="FILE",
        help="YAML with the values that differ from the defaults (demo, paper, bench: from their preset); "
        "repeatable, later files take precedence",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="PATH=VALUE",
        help="e.g. scene.clearance_m=0.002; repeatable",
    )


def config_of(args: argparse.Namespace, preset: str | None = None) -> Config:
    """Read the configuration of a command line, on top of a world, parts and a preset; ``seek`` has its own.

    Raises:
        RequestError: A file cannot be read, or a key, a value or the seed is invalid.
    """
    from mjx_fit.utils.randomness import require_seed

    if hasattr(args, "seed"):  # before sensors and data are read
        require_seed(args.seed)
    return read_config(config_paths(args, preset), args.set)


def config_paths(args: argparse.Namespace, preset: str | None = None) -> list[Path]:
    """Return the files of ``config_of``, of which later ones take precedence."""
    from mjx_fit.utils import resources

    preset_file = [] if preset is None else [resources.folder("configs") / f"{preset}.yaml"]
    if getattr(args, "policy", None) == SEEK:
        preset_file = [resources.folder("configs") / f"{SEEK_RUN}.yaml", *preset_file]
    return [*world_file(args.world), *parts_file(args.parts), *preset_file, *args.config]


def run_of(args: argparse.Namespace, policy: str | None = None) -> Path:
    """Return the folder of the training run: from ``--run``, or weights of the package.

    Args:
        args: Command line.
        policy: Name of the policy, which has weights of its own if it is ``seek``; None: ``--policy``.
    """
    from mjx_fit.utils import resources

    policy = policy or getattr(args, "policy", None)
    return args.run or resources.run_folder(SEEK_RUN if policy == SEEK else None)


def policy_of(args: argparse.Namespace, config: Config) -> "tuple[Config, Policy | None]":
    """Load the policy of ``--policy``; None: the library's policies that follow no belief.

    Returns:
        The configuration, for ``seek`` with the network of the sensor of ``--run``, and the policy.

    Raises:
        RequestError: The file holds no such policy, or the sensor cannot read an attempt in progress.
    """
    from mjx_fit.config.schema import require_room
    from mjx_fit.control.leaning import lean_search
    from mjx_fit.control.policy_file import is_policy_file, load_policy
    from mjx_fit.control.search import raster_search
    from mjx_fit.task.seek import seek_by_geometry, seek_with
    from mjx_fit.training.sensor_loader import load_trained_sensor

    if args.policy == SEEK and config.filter.reads == "geometry":
        return config, seek_by_geometry(config)
    if args.policy == SEEK:
        return seek_with(load_trained_sensor(run_of(args)), config)
    if args.policy == RASTER:
        require_room(config, "seek.raster_m", config.seek.raster_m)
        return config, raster_search(config.seek)
    if args.policy == TILT:
        return config, lean_search(config.seek)
    return config, load_policy(args.policy) if args.policy and is_policy_file(args.policy) else None
