"""Commands ``render`` and ``view``: show an assembly as a video, or live."""

import argparse
from typing import TYPE_CHECKING

from mjx_fit.cli.options import RUN, SEEK, add_command, config_of, configurable, run_of, simulating
from mjx_fit.cli.path_argument import path, run_path
from mjx_fit.utils.errors import RequestError

if TYPE_CHECKING:
    from collections.abc import Generator

    from mjx_fit.evaluation.recording import Recording


def add_render(parsers: argparse._SubParsersAction) -> None:
    """Add ``render``."""
    parser = add_command(parsers, "render", render, "render a video of an assembly and its belief")
    parser.set_defaults(draws=True)
    parser.add_argument("--out", type=path, required=True, metavar="VIDEO", help=".mp4 or .gif")
    parser.add_argument("--fps", type=int, default=20, metavar="N", help="frames per second (default 20)")
    parser.add_argument(
        "--beside",
        type=path,
        metavar="RESULT.json",
        help="show the same trial of another result, made with weights of the package, on the right",
    )
    _with_what_to_play(parser, 8.0)


def add_view(parsers: argparse._SubParsersAction) -> None:
    """Add ``view``."""
    parser = add_command(parsers, "view", view, "watch a live assembly")
    parser.add_argument(
        "--browser", action="store_true", help="in a browser, by viser, even where there is a display"
    )
    parser.add_argument(
        "--port", type=int, default=8080, metavar="P", help="port of the browser's page (default 8080)"
    )
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="serve the browser's page to others, e.g. 0.0.0.0 (default 127.0.0.1: this machine only)",
    )
    _with_what_to_play(parser, 2.0)


def _with_what_to_play(parser: argparse.ArgumentParser, speed: float) -> None:
    parser.add_argument(
        "result",
        type=path,
        nargs="?",
        metavar="RESULT.json",
        help="of evaluate assembly (default: a new assembly, by --world, --config, --set and --seed)",
    )
    parser.add_argument("--run", type=run_path, metavar="RUN", help=RUN)
    parser.add_argument("--method", default="full", metavar="A", help="default: full")
    parser.add_argument("--trial", type=int, default=0, metavar="N", help="from 0 (default 0)")
    parser.add_argument("--attempt", type=int, metavar="K", help="only this attempt of the trial, from 1")
    parser.add_argument(
        "--speed", type=float, default=speed, metavar="X", help=f"times as fast (default {speed:g})"
    )
    simulating(parser)
    configurable(parser)


def render(args: argparse.Namespace) -> None:
    """Run ``render``."""
    from mjx_fit.viz.video import render, require

    require(args.out, args.fps, args.speed)
    if args.beside is not None:
        _render_beside(args)
        return
    *_, recording = _played(args)
    recording = recording if args.attempt is None else recording.only(args.attempt)
    print(render(recording, args.out, args.fps, args.speed))


def _render_beside(args: argparse.Namespace) -> None:
    """Show the trial of two results side by side; the second one is made with weights of the package."""
    from mjx_fit.viz.side_by_side import render_beside

    if args.result is None:
        raise RequestError("--beside: cannot be used without a result file to show on the left")
    alone = argparse.Namespace(**vars(args) | {"result": args.beside, "run": None})
    left, right = _played(args), _played(alone)  # both are checked before the first is simulated
    (*_, left), (*_, right) = left, right
    if args.attempt is not None:
        left, right = left.only(args.attempt), right.only(args.attempt)
    titles = args.result.stem, args.beside.stem
    print(render_beside((left, right), titles, args.out, args.fps, args.speed))


def view(args: argparse.Namespace) -> None:
    """Run ``view``."""
    from mjx_fit.viz.viewer import view

    view(_played(args), args.attempt, args.speed, args.browser, args.port, args.host)


def _played(args: argparse.Namespace) -> "Generator[Recording]":
    """Simulate the requested assembly lazily, as the consumer shows it."""
    from mjx_fit.config.schema import config_from_stored
    from mjx_fit.engines.select import make_engine
    from mjx_fit.evaluation import playback, results
    from mjx_fit.task.seek import GEOMETRIC, seek_by_geometry, seek_with
    from mjx_fit.training.sensor_loader import load_trained_sensor

    asked = args.world or args.parts or args.config or args.set or args.seed or args.engine != "auto"
    if args.result is not None and asked:
        raise RequestError(
            "--world, --parts, --config, --set, --seed, --engine: cannot be combined with a result file, "
            "which stores its own"
        )
    pick = playback.Pick(args.method, args.trial, args.attempt)
    if args.result is None:
        config = config_of(args)
        engine, sensor = make_engine(args.engine, config), load_trained_sensor(run_of(args))
        return playback.record(config, pick, args.seed, engine, sensor)
    result = results.read(args.result)
    config, policy = config_from_stored(result.config), None
    name = str(result.request.get("policy", "")).partition("@")[0]
    sensor = load_trained_sensor(run_of(args, name))
    if name == SEEK:
        config, policy = seek_with(sensor, config)
    elif name == GEOMETRIC:
        policy = seek_by_geometry(config)
    engine = make_engine(result.engine, config, policy)
    return playback.replay(result, pick, engine, sensor)
