"""The command line: parses, calls the library, and turns a refused request into one line and exit code 2."""

import argparse
import errno
import json
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import NoReturn

from mjx_fit import config as config_
from mjx_fit.config import Config
from mjx_fit.errors import RequestError, WorkError

_WRONG_PLACE = {
    errno.ENOENT,
    errno.ENOTDIR,
    errno.EEXIST,
    errno.EISDIR,
    errno.EACCES,
    errno.EPERM,
    errno.EROFS,
}
"""What the system says of a path that should not have been asked for; a full disk is another matter."""

# Each command imports what it needs: `mjx-fit --help` answers at once.


class _Parser(argparse.ArgumentParser):
    """argparse, but with a refusal in one line."""

    def error(self, message: str) -> NoReturn:
        raise RequestError(f"{message}; see {self.prog} --help")


def main(argv: Sequence[str] | None = None) -> int:
    """Runs a command.

    Returns:
        0: done. 1: the work failed. 2: the request was wrong; one line on stderr says what is allowed.
    """
    try:
        args = _parser().parse_args(argv)
        if args.computes:
            from mjx_fit import runtime

            runtime.configure()
        args.command(args)
    except RequestError as error:
        return _refuse(str(error), 2)
    except WorkError as error:
        return _refuse(str(error), 1)
    except OSError as error:
        where = f"{error.filename} cannot be used: {error.strerror}" if error.filename else str(error)
        return _refuse(where, 2 if error.errno in _WRONG_PLACE else 1)
    except KeyboardInterrupt:
        _refuse("stopped; collect, train and demo go on when the same command is given again", 1)
        # At once: XLA may still be compiling in a thread of its own, and an orderly exit would crash in it.
        sys.stderr.flush()
        os._exit(1)
    return 0


def _refuse(message: str, code: int) -> int:
    print(f"mjx-fit: {' '.join(message.split())}", file=sys.stderr)
    return code


def _demo(args: argparse.Namespace) -> None:
    from mjx_fit.demo import Size, demo

    demo(_config(args, preset="quick"), args.out, Size())


def _collect(args: argparse.Namespace) -> None:
    from mjx_fit.dataset.collect import Plan, collect

    plan = Plan(**{field.name: getattr(args, field.name) for field in fields(Plan)})
    collect(_config(args), args.out, plan)
    part = f" (part {plan.shard_index} of {plan.num_shards})" if plan.num_shards > 1 else ""
    print(f"{args.out}: complete{part}")


def _data_info(args: argparse.Namespace) -> None:
    from mjx_fit.dataset.store import describe

    _show(describe(args.folder), args.json)


def _data_check(args: argparse.Namespace) -> None:
    from mjx_fit.dataset import manifest
    from mjx_fit.dataset.store import damages

    found = damages(args.folder)
    for name, what in found.items():
        print(f"{name}: {what}")
    if found:
        raise WorkError(
            f"{args.folder}: {len(found)} damaged; repeat its collect command to make shards anew"
        )
    there = manifest.read(args.folder)
    state = "complete" if there.complete else "not complete: repeat its collect command"
    print(f"{args.folder}: {len(there.shards)} shards, all whole; {state}")


def _data_merge(args: argparse.Namespace) -> None:
    from mjx_fit.dataset.merge import merge

    merge(args.folders, args.out)
    print(f"{args.out}: complete")


def _data_export(args: argparse.Namespace) -> None:
    from mjx_fit.dataset.export import export

    export(args.folder, args.out)
    print(args.out)


def _train(args: argparse.Namespace) -> None:
    from mjx_fit.dataset.store import load
    from mjx_fit.training.loop import train

    config = _config(args)
    if args.epochs is not None:
        if args.epochs < 1:
            raise RequestError(f"--epochs: {args.epochs} is not allowed: it must be at least 1")
        config = replace(config, train=replace(config.train, epochs=args.epochs))
    train(load(args.data), config, args.out, args.seed)
    print(f"{args.out}: trained for {config.train.epochs} epochs")


def _evaluate_attempt(args: argparse.Namespace) -> None:
    from mjx_fit.evaluation import experiments
    from mjx_fit.report.terminal import print_summary

    print_summary(experiments.attempt(_config(args), args.out, args.trials, args.seed, args.engine))


def _evaluate_assembly(args: argparse.Namespace) -> None:
    from mjx_fit.evaluation import experiments
    from mjx_fit.report.terminal import print_summary

    config = _config(args)
    result = experiments.assembly(
        config, args.out, args.run, args.methods, args.trials, args.seed, args.engine
    )
    print_summary(result)


def _report(args: argparse.Namespace) -> None:
    from mjx_fit.report.build import beside, build

    print(build(args.inputs, args.out or beside(args.inputs[0])))


def _bench(args: argparse.Namespace) -> None:
    from mjx_fit.bench.run import bench

    bench(_config(args), args.json)


def _info(args: argparse.Namespace) -> None:
    import jax

    from mjx_fit import provenance
    from mjx_fit.simulate.engine import resolve

    _show(
        {
            "versions": provenance.versions(),
            "devices": [f"{device.platform}: {device.device_kind}" for device in jax.devices()],
            "engine": resolve("auto"),
        },
        args.json,
    )


def _config(args: argparse.Namespace, preset: str | None = None) -> Config:
    from mjx_fit import resources

    path = args.config
    if path is None and preset is not None:
        path = resources.folder("configs") / f"{preset}.yaml"
    return config_.load(path, args.set)


def _show(tree: dict, as_json: bool) -> None:
    import yaml

    print(
        json.dumps(tree, indent=1)
        if as_json
        else yaml.safe_dump(tree, sort_keys=False, allow_unicode=True).rstrip()
    )


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="mjx-fit", description="Contact-rich assembly under uncertainty, on JAX and MuJoCo."
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    demo = _command(commands, "demo", _demo, "collect, train, evaluate and report, small, within minutes")
    demo.add_argument("--out", type=Path, default=Path("runs/demo"), metavar="DIR")
    _configurable(demo)

    collect = _command(commands, "collect", _collect, "simulate interactions and store them")
    collect.add_argument("--out", type=Path, required=True, metavar="DIR")
    collect.add_argument(
        "--episodes", type=int, default=3000, metavar="N", help="interactions (default 3000)"
    )
    collect.add_argument(
        "--steps", type=int, default=200, metavar="J", help="most actions in one (default 200)"
    )
    collect.add_argument("--policy", default="random", help="random, spiral or mixed (default random)")
    collect.add_argument(
        "--batch", type=int, default=250, metavar="B", help="most worlds at once, one file (default 250)"
    )
    collect.add_argument(
        "--sequence", type=int, default=1, metavar="K", help="attempts in a row at one hole (default 1)"
    )
    collect.add_argument(
        "--shard-index", type=int, default=0, metavar="I", help="which part of the whole (default 0)"
    )
    collect.add_argument(
        "--num-shards", type=int, default=1, metavar="N", help="of how many parts, on as many machines"
    )
    _simulating(collect)
    _configurable(collect)

    _data(commands.add_parser("data", help="look at a data set, check, join or convert it"))

    train = _command(commands, "train", _train, "train sensors and noise models; goes on by itself")
    train.add_argument("--data", type=Path, required=True, metavar="DIR")
    train.add_argument("--out", type=Path, required=True, metavar="RUN")
    train.add_argument("--epochs", type=int, metavar="N", help="instead of the configuration's")
    train.add_argument("--seed", type=int, default=0, metavar="S")
    _configurable(train)

    _evaluations(commands.add_parser("evaluate", help="run an experiment"))

    report = _command(commands, "report", _report, "one page with figures from results, runs and data sets")
    report.add_argument("inputs", type=Path, nargs="+", metavar="FILE.json|DIR")
    report.add_argument("--out", type=Path, metavar="DIR", help="default: report in the first input's folder")

    bench = _command(commands, "bench", _bench, "speed of the engines, side by side")
    bench.add_argument("--json", action="store_true")
    _configurable(bench)

    info = _command(commands, "info", _info, "versions, devices and the engine that auto means")
    info.add_argument("--json", action="store_true")
    return parser


def _data(data: argparse.ArgumentParser) -> None:
    whats = data.add_subparsers(required=True, metavar="WHAT")
    info = _command(whats, "info", _data_info, "what a data set holds")
    info.add_argument("folder", type=Path, metavar="DIR")
    info.add_argument("--json", action="store_true")
    check = _command(whats, "check", _data_check, "find every damaged, missing or foreign file")
    check.add_argument("folder", type=Path, metavar="DIR")
    merge = _command(whats, "merge", _data_merge, "join the parts that collect made with --num-shards")
    merge.add_argument("folders", type=Path, nargs="+", metavar="DIR")
    merge.add_argument("--out", type=Path, required=True, metavar="DIR")
    export = _command(whats, "export", _data_export, "one file for others")
    export.add_argument("folder", type=Path, metavar="DIR")
    export.add_argument(
        "--out", type=Path, required=True, metavar="FILE", help=".npz, or .hdf5 as robomimic has it"
    )


def _evaluations(evaluate: argparse.ArgumentParser) -> None:
    experiments = evaluate.add_subparsers(required=True, metavar="EXPERIMENT")
    attempt = _command(experiments, "attempt", _evaluate_attempt, "success rate of single attempts")
    assembly = _command(experiments, "assembly", _evaluate_assembly, "whole assemblies under several methods")
    assembly.add_argument("--run", type=Path, metavar="RUN", help="folder of a training run")
    assembly.add_argument(
        "--methods",
        default="failure_only,failure_position,full,oracle",
        metavar="A,B",
        help="default: %(default)s",
    )
    trials = {
        attempt: "matched attempts for each shape, and mismatched ones in all (default 100)",
        assembly: "assemblies under each method (default 100)",
    }
    for command in (attempt, assembly):
        command.add_argument("--out", type=Path, required=True, metavar="FILE.json")
        command.add_argument("--trials", type=int, default=100, metavar="N", help=trials[command])
        _simulating(command)
        _configurable(command)


def _command(
    commands: argparse._SubParsersAction, name: str, run: Callable[[argparse.Namespace], None], text: str
) -> argparse.ArgumentParser:
    parser = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
    parser.set_defaults(command=run, computes=False)
    return parser


def _simulating(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--engine", default="auto", help="auto, mjx or native (default auto)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="root seed (default 0)")


def _configurable(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(computes=True)
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="YAML with what differs from the defaults"
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="PATH=VALUE",
        help="e.g. scene.clearance_m=0.002; repeatable",
    )
