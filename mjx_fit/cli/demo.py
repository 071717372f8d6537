"""Run the demo: assemblies, a video and a page within minutes, optionally after a short training."""

from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console

from mjx_fit.cli.options import SEEK, SEEK_RUN
from mjx_fit.config.files import read_tree
from mjx_fit.config.schema import Config
from mjx_fit.data.collect import collect
from mjx_fit.data.plan import Plan
from mjx_fit.engines.interface import Engine
from mjx_fit.engines.select import make_engine
from mjx_fit.evaluation.assembly import assembly
from mjx_fit.evaluation.request import Request
from mjx_fit.evaluation.results import Result
from mjx_fit.report.build import build
from mjx_fit.report.figures.training_run import read_metrics
from mjx_fit.report.terminal import print_summary
from mjx_fit.task.seek import seek_with
from mjx_fit.training.run import Run
from mjx_fit.training.sensor_loader import load_trained_sensor
from mjx_fit.training.train import train_from
from mjx_fit.utils import children, files, locks, resources
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.filesystem import path_inside

METHODS = "failure_only,full,oracle"
POLICY = "spiral"
VIDEO = "assembly.mp4"


@dataclass(frozen=True)
class Size:
    """Size of the demo: about three minutes on two shared cores, without training.

    Attributes:
        assemblies: Trials of the assembly experiment.
        episodes: Episodes to collect for training.
        steps: Maximum number of actions in one episode.
        fps: Frames per second of the video.
        speed: Playback speed of the video.
    """

    assemblies: int = 3
    episodes: int = 1500
    steps: int = 100
    fps: int = 8
    speed: float = 12.0


def run_demo(config: Config, out: Path, size: Size, train: bool) -> None:
    """Run every stage into ``out``; a rerun skips finished stages.

    Args:
        config: The configuration.
        out: The folder.
        size: Size of the demo.
        train: Collect data and train on them, instead of using the weights of the package.

    Raises:
        RequestError: The folder holds the demo of another configuration, or other files.
    """
    parts = {
        "data",
        "train",
        "assembly.json",
        "assembly.parts",
        "assembly.broken",
        "seek.json",
        "seek.parts",
        "seek.broken",
        VIDEO,
        "figures",
        "index.html",
    }
    foreign = files.foreign(out, parts)
    if foreign:
        raise RequestError(f"--out: {out} cannot be used: it holds other files ({foreign[0]})")
    with locks.holding(out):
        _stages(config, out, size, train)


def _stages(config: Config, out: Path, size: Size, train: bool) -> None:
    console = Console(highlight=False, emoji=False)
    run, engine = resources.folder("weights"), make_engine("auto", config)
    if train:
        run = path_inside(out, "train")
        _collect(config, path_inside(out, "data"), size, engine, console)
        _train(config, path_inside(out, "data"), run, console)

    console.rule(f"{size.assemblies} assemblies of {config.task.n_holes} pegs, each under {METHODS}")
    result = out / "assembly.json"
    request = Request(config, result, engine, size.assemblies, methods=METHODS)
    print_summary(assembly(request.with_sensors_of(run)))

    console.rule(f"the same assemblies with {SEEK}: act on the belief while touching, with pushes of 5 N")
    print_summary(_sought(config, out / "seek.json", size))

    console.rule("a video of one of them, both ways")
    if not (out / VIDEO).exists():
        _video(result, out / "seek.json", run, out / VIDEO, size, console)

    console.rule("report")
    console.print(str(build([out], out)), soft_wrap=True)


def _sought(config: Config, result: Path, size: Size) -> Result:
    """Run the assemblies with the policy ``seek``, its preset and its own weights."""
    gentle = resources.run_folder(SEEK_RUN)
    sensor, preset = load_trained_sensor(gentle), resources.folder("configs") / f"{SEEK_RUN}.yaml"
    own = {name: replace(getattr(config, name), **keys) for name, keys in read_tree(preset).items()}
    own |= {"sensor": sensor.config.sensor, "train": sensor.config.train}
    config, policy = seek_with(sensor, replace(config, **own))
    request = Request(config, result, make_engine("auto", config, policy), size.assemblies, methods="full")
    return assembly(request.with_sensors_of(gentle))


def _collect(config: Config, data: Path, size: Size, engine: Engine, console: Console) -> None:
    console.rule(f"{size.episodes} episodes of up to {size.steps} actions")
    collect(config, data, Plan(size.episodes, size.steps, POLICY), engine)


def _train(config: Config, data: Path, run: Path, console: Console) -> None:
    console.rule("train sensors and filters on them")
    train_from([data], config, Run(run, seed=0))
    best = min(read_metrics(run / "metrics.jsonl"), key=lambda row: row["val_nll"])
    console.print(
        f"validation NLL: {best['val_nll']:.3f} after the update, {best['prior_nll']:.3f} before it "
        f"(epoch {best['epoch'] + 1})"
    )


def _video(result: Path, seek: Path, run: Path, video: Path, size: Size, console: Console) -> None:
    """Render in a separate process: MuJoCo chooses its OpenGL on import, and is already imported here."""
    words = ["render", result, "--beside", seek, "--run", run, "--out", video]
    words += ["--fps", size.fps, "--speed", size.speed]
    if children.run([str(word) for word in words]):
        console.print("the video failed; everything else is complete")
