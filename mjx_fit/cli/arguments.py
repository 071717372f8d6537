"""What each command may be asked for."""

import argparse
from collections.abc import Callable

from mjx_fit import __version__
from mjx_fit.cli import commands
from mjx_fit.cli.options import Parser, add_command, configurable, simulating, with_config
from mjx_fit.cli.path_argument import path

_RESUME = (
    commands.demo,
    commands.collect,
    commands.data_merge,
    commands.train,
    commands.evaluate_position,
    commands.evaluate_insertion,
    commands.evaluate_assembly,
    commands.paper,
)
"""Commands that keep what they have done when they are stopped."""

_RUN = "folder of a training run (default: the weights that come with the package)"


def parser() -> argparse.ArgumentParser:
    """The parser of the whole command line."""
    root = Parser(prog="mjx-fit", description="Contact-rich assembly under uncertainty, on JAX and MuJoCo.")
    root.add_argument("--version", action="version", version=f"mjx-fit {__version__}")
    parsers = root.add_subparsers(required=True, metavar="COMMAND")
    _demo(parsers)
    _collect(parsers)
    _data(parsers.add_parser("data", help="look at a data set, check, join or convert it"))
    _train(parsers)
    _evaluations(parsers.add_parser("evaluate", help="run an experiment"))
    _paper(parsers)
    _report(parsers)
    _pictures(parsers)
    _about(parsers)
    return root


def _demo(parsers: argparse._SubParsersAction) -> None:
    demo = _command(
        parsers, "demo", commands.demo, "what it is about: assemblies, a video and a page within minutes"
    )
    demo.add_argument(
        "--out", type=path, metavar="DIR", help="default: runs/demo, or runs/demo-train with --train"
    )
    demo.add_argument(
        "--train", action="store_true", help="collect a little data and train on them, instead of our weights"
    )
    configurable(demo)


def _collect(parsers: argparse._SubParsersAction) -> None:
    collect = _command(parsers, "collect", commands.collect, "simulate interactions and store them")
    collect.add_argument("--out", type=path, required=True, metavar="DIR")
    collect.add_argument(
        "--episodes", type=int, default=3000, metavar="N", help="interactions (default 3000)"
    )
    length = collect.add_mutually_exclusive_group()
    length.add_argument(
        "--actions", type=int, metavar="J", help="most actions in one (default: task.attempt_actions, 100)"
    )
    length.add_argument("--steps", dest="actions", type=int, help=argparse.SUPPRESS)  # its former name
    collect.add_argument("--policy", default="spiral", help="spiral, random or mixed (default spiral)")
    collect.add_argument(
        "--batch", type=int, default=250, metavar="B", help="most interactions in one file (default 250)"
    )
    collect.add_argument(
        "--sequence", type=int, default=1, metavar="K", help="attempts in a row at one hole (default 1)"
    )
    collect.add_argument(
        "--run",
        type=path,
        metavar="RUN",
        help="later attempts start from what the sensor of this run believes (default: drawn beliefs)",
    )
    collect.add_argument(
        "--shard-index", type=int, default=0, metavar="I", help="which part of the whole (default 0)"
    )
    collect.add_argument(
        "--num-shards", type=int, default=1, metavar="N", help="of how many parts, on as many machines"
    )
    simulating(collect)
    configurable(collect)


def _train(parsers: argparse._SubParsersAction) -> None:
    train = _command(
        parsers,
        "train",
        commands.train,
        "train sensors and noise models, as the weights that ship; presets by --config",
    )
    train.add_argument("--data", type=path, required=True, metavar="DIR")
    train.add_argument("--out", type=path, required=True, metavar="RUN")
    train.add_argument(
        "--epochs", type=int, metavar="N", help="passes over the data (default: train.epochs, 30)"
    )
    train.add_argument("--seed", type=int, default=0, metavar="S", help="root seed (default 0)")
    train.add_argument(
        "--members", type=int, default=1, metavar="K", help="train K sensors at once, into RUN/member-0, ..."
    )
    train.add_argument(
        "--init",
        type=path,
        metavar="RUN",
        help="start from the sensors of another run, of the same network and shapes (default: new weights)",
    )
    configurable(train)


def _paper(parsers: argparse._SubParsersAction) -> None:
    paper = _command(parsers, "paper", commands.paper, "the paper: data, training, all experiments, report")
    paper.add_argument("--out", type=path, required=True, metavar="DIR")
    paper.add_argument("--size", default="cpu", help="quick, cpu or full (default cpu)")
    paper.add_argument("--seed", type=int, default=0, metavar="S", help="root seed (default 0)")
    configurable(paper)


def _report(parsers: argparse._SubParsersAction) -> None:
    report = _command(parsers, "report", commands.report, "one page from results, videos, runs and data sets")
    report.add_argument("inputs", type=path, nargs="+", metavar="FILE|DIR")
    report.add_argument("--out", type=path, metavar="DIR", help="default: report in the first input's folder")


def _about(parsers: argparse._SubParsersAction) -> None:
    bench = _command(parsers, "bench", commands.bench, "speed of the engines, side by side")
    bench.add_argument("--json", action="store_true")
    configurable(bench)

    keys = _command(parsers, "config", commands.config_keys, "every key, with its unit, range and default")
    keys.add_argument("--json", action="store_true")
    with_config(keys)

    info = _command(parsers, "info", commands.info, "versions, devices and the engine that auto means")
    info.add_argument("--json", action="store_true")
    info.set_defaults(computes=True)


def _pictures(parsers: argparse._SubParsersAction) -> None:
    render = _command(parsers, "render", commands.render, "a video of an assembly and of what is believed")
    render.set_defaults(draws=True)
    render.add_argument("--out", type=path, required=True, metavar="VIDEO", help=".mp4 or .gif")
    render.add_argument("--fps", type=int, default=20, metavar="N", help="frames per second (default 20)")
    view = _command(parsers, "view", commands.view, "watch an assembly as it is played")
    view.add_argument(
        "--browser", action="store_true", help="in a browser, with viser, though there is a display"
    )
    view.add_argument(
        "--port", type=int, default=8080, metavar="P", help="of the browser's page (default 8080)"
    )
    view.add_argument(
        "--host",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="serve the browser's page to others, too, e.g. 0.0.0.0 (default 127.0.0.1: this machine only)",
    )
    for command, speed in ((render, 8.0), (view, 2.0)):
        command.add_argument(
            "result",
            type=path,
            nargs="?",
            metavar="RESULT.json",
            help="of evaluate assembly (default: an assembly of its own, by --config, --set and --seed)",
        )
        command.add_argument("--run", type=path, metavar="RUN", help=_RUN)
        command.add_argument("--method", default="full", metavar="A", help="default: full")
        command.add_argument("--trial", type=int, default=0, metavar="N", help="from 0 (default 0)")
        command.add_argument("--attempt", type=int, metavar="K", help="only this one of the trial, from 1")
        command.add_argument(
            "--speed", type=float, default=speed, metavar="X", help=f"times as fast (default {speed:g})"
        )
        simulating(command)
        configurable(command)


def _data(data: argparse.ArgumentParser) -> None:
    whats = data.add_subparsers(required=True, metavar="WHAT")
    info = _command(whats, "info", commands.data_info, "what a data set holds; its pairs are peg-hole")
    info.add_argument("folder", type=path, metavar="DIR")
    info.add_argument("--json", action="store_true")
    check = _command(whats, "check", commands.data_check, "find every damaged, missing or foreign file")
    check.add_argument("folder", type=path, metavar="DIR")
    merge = _command(whats, "merge", commands.data_merge, "join parts made with --num-shards")
    merge.add_argument("folders", type=path, nargs="+", metavar="DIR")
    merge.add_argument("--out", type=path, required=True, metavar="DIR")
    export = _command(whats, "export", commands.data_export, "one file for others")
    export.add_argument("folder", type=path, metavar="DIR")
    export.add_argument(
        "--out", type=path, required=True, metavar="FILE", help=".npz, or .hdf5 as robomimic has it"
    )


def _evaluations(evaluate: argparse.ArgumentParser) -> None:
    experiments = evaluate.add_subparsers(required=True, metavar="EXPERIMENT")
    attempt = _command(experiments, "attempt", commands.evaluate_attempt, "success rate of single attempts")
    assembly = _command(
        experiments, "assembly", commands.evaluate_assembly, "assemblies under several methods"
    )
    position = _command(
        experiments, "position", commands.evaluate_position, "attempts at one hole: its position"
    )
    insertion = _command(
        experiments, "insertion", commands.evaluate_insertion, "attempts at one hole: insertion"
    )
    compared = {
        position: "full,frame_by_frame,oracle",
        insertion: "full,no_update,sample,frame_by_frame,oracle",
        assembly: "failure_only,failure_position,full,oracle",
    }
    for command, methods in compared.items():
        command.add_argument("--run", type=path, metavar="RUN", help=_RUN)
        command.add_argument("--methods", default=methods, metavar="A,B", help="default: %(default)s")
    insertion.add_argument(
        "--seeds", type=int, default=5, metavar="K", help="of the wiggles, for each draw (default 5)"
    )
    calibration = _command(
        experiments,
        "calibration",
        commands.evaluate_calibration,
        "a trained sensor on attempts of a data set",
    )
    calibration.add_argument("--run", type=path, metavar="RUN", help=_RUN)
    calibration.add_argument(
        "--data", type=path, required=True, metavar="DIR", help="a data set that it was not trained on"
    )
    calibration.add_argument("--out", type=path, required=True, metavar="FILE.json")
    calibration.add_argument(
        "--seed", type=int, default=0, metavar="S", help="root seed of noise (default 0)"
    )
    configurable(calibration)
    trials = {
        attempt: (100, "matched attempts for each shape, and mismatched ones in all"),
        position: (100, "holes that do not match, and as many that do"),
        insertion: (150, "draws of a hole and its detection"),
        assembly: (100, "assemblies under each method"),
    }
    for command, (count, what) in trials.items():
        command.add_argument("--out", type=path, required=True, metavar="FILE.json")
        command.add_argument(
            "--trials", type=int, default=count, metavar="N", help=f"{what} (default {count})"
        )
        simulating(command)
        configurable(command)


def _command(
    parsers: argparse._SubParsersAction, name: str, run: Callable[[argparse.Namespace], None], text: str
) -> argparse.ArgumentParser:
    return add_command(parsers, name, run, text, resumes=run in _RESUME)
