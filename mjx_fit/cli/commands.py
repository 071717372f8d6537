"""What each command does: reads its arguments and calls the library."""

import argparse
import json
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config, config_from_stored
from mjx_fit.config.sections.learning import MAX_EPOCHS
from mjx_fit.training.run_folder import Run
from mjx_fit.utils.errors import RequestError, WorkError, require

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from mjx_fit.evaluation.recording import Recording
    from mjx_fit.evaluation.request import Request
    from mjx_fit.evaluation.results import Result

# Each command imports what it needs: `mjx-fit --help` answers at once.


def demo(args: argparse.Namespace) -> None:
    from mjx_fit.cli.demo import Size, run_demo

    out = args.out or Path("runs", "demo-train" if args.train else "demo")
    run_demo(_config(args, preset="quick" if args.train else "demo"), out, Size(), args.train)


def collect(args: argparse.Namespace) -> None:
    from mjx_fit.data.collect import collect, invalid_in
    from mjx_fit.data.plan import Plan
    from mjx_fit.engines.select import make_engine
    from mjx_fit.task.estimator import filter_update
    from mjx_fit.training.sensor_loader import load_trained_sensor

    config = _config(args)
    asked = {field.name: getattr(args, field.name) for field in fields(Plan) if field.name != "sensor"}
    if args.actions is None:
        asked["actions"] = config.task.attempt_actions
    plan, update = Plan(**asked), None
    if args.run is not None:
        sensor = load_trained_sensor(args.run)
        sensor.say_if_away(config, "collect")
        plan, update = replace(plan, sensor=sensor.fingerprint), filter_update(config, sensor.network)
    collect(config, args.out, plan, make_engine(plan.engine, config), update)
    part = f" (part {plan.shard_index} of {plan.num_shards})" if plan.num_shards > 1 else ""
    print(f"{args.out}: complete{part}{invalid_in(args.out)}")


def data_info(args: argparse.Namespace) -> None:
    from mjx_fit.data.reader import describe

    _show(describe(args.folder), args.json)


def data_check(args: argparse.Namespace) -> None:
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
    print(f"{args.folder}: not complete: {count}. Go on with")
    print(plan.command(args.folder), "and its --config and --set, if it had any")


def _what_to_do(found: dict[str, str], manifest: str) -> str:
    lost = sum(not what.startswith("foreign") for what in found.values())
    if manifest in found or not lost:
        return f"{len(found)} wrong"
    return f"{lost} of its shards damaged; its collect command makes them anew"


def data_merge(args: argparse.Namespace) -> None:
    from mjx_fit.data.merge import merge

    merge(args.folders, args.out)
    print(f"{args.out}: complete")


def data_export(args: argparse.Namespace) -> None:
    from mjx_fit.data.export import export

    export(args.folder, args.out)
    print(args.out)


def train(args: argparse.Namespace) -> None:
    from mjx_fit.data.manifest import read_manifest
    from mjx_fit.training import run_files, run_folder
    from mjx_fit.training.train import train_from

    config = _config(args)
    run_folder.require_members(args.members)
    if args.epochs is not None:
        require("--epochs", args.epochs, 1, MAX_EPOCHS)
        config = replace(config, train=replace(config.train, epochs=args.epochs))
    index, of = read_manifest(args.data).part
    if of > 1:
        print(f"{args.data}: part {index} of {of} of a data set; data merge joins them")
    was_left = train_from(args.data, config, Run(args.out, args.seed, args.members, args.init))
    for folder in run_folder.members(args.out, args.members):
        print(f"{folder}: {run_files.summary(folder)}")
        ended = run_files.ended(folder, config)
        if not was_left:
            print(f"{folder}: nothing was left to do: {ended}")
        elif ended.startswith("stopped early"):
            print(f"{folder}: {ended}")
    if not args.config:
        print(_other_trainings())


def _other_trainings() -> str:
    """What ``train`` has done without a preset, and which presets there are."""
    from mjx_fit.utils import resources

    folder = resources.folder("configs")
    folder = folder.relative_to(Path.cwd()) if folder.is_relative_to(Path.cwd()) else folder
    return (
        "trained as the weights that come with the package; other presets, by --config: "
        f"{folder / 'quick.yaml'} (no frame-by-frame baseline: a third less time), "
        f"{folder / 'paper.yaml'} (the paper's sensor, 5000 epochs: for an accelerator)"
    )


def evaluate_attempt(args: argparse.Namespace) -> None:
    from mjx_fit.evaluation.attempt import attempt

    _evaluate(attempt, args)


def evaluate_position(args: argparse.Namespace) -> None:
    from mjx_fit.evaluation.position import position

    _evaluate(position, args)


def evaluate_insertion(args: argparse.Namespace) -> None:
    from mjx_fit.evaluation.insertion import insertion

    _evaluate(insertion, args)


def evaluate_assembly(args: argparse.Namespace) -> None:
    from mjx_fit.evaluation.assembly import assembly

    _evaluate(assembly, args)


def _evaluate(experiment: "Callable[[Request], Result]", args: argparse.Namespace) -> None:
    """Runs an experiment, with a sensor where it has a --run, and prints what it came to."""
    from mjx_fit.engines.select import make_engine
    from mjx_fit.evaluation.request import Request
    from mjx_fit.report.terminal import print_summary

    config = _config(args)
    request = Request(config, args.out, make_engine(args.engine, config), args.trials, args.seed)
    if hasattr(args, "run"):
        request = replace(request, methods=args.methods, seeds=getattr(args, "seeds", 1))
        request = request.with_sensors_of(_run(args))
    print_summary(experiment(request))


def evaluate_calibration(args: argparse.Namespace) -> None:
    from mjx_fit.evaluation.calibration import calibrate
    from mjx_fit.report.terminal import print_summary

    print_summary(calibrate(_config(args), args.out, _run(args), args.data, args.seed))


def paper(args: argparse.Namespace) -> None:
    from mjx_fit.cli.paper import run_paper, size_of

    size = size_of(args.size)
    run_paper(_config(args, preset=size.preset), args.out, size, args.seed)


def report(args: argparse.Namespace) -> None:
    from mjx_fit.report.build import beside, build

    print(build(args.inputs, args.out or beside(args.inputs[0])))


def render(args: argparse.Namespace) -> None:
    from mjx_fit.viz.video import render, require

    require(args.out, args.fps, args.speed)
    *_, recording = _played(args)
    recording = recording if args.attempt is None else recording.only(args.attempt)
    print(render(recording, args.out, args.fps, args.speed))


def view(args: argparse.Namespace) -> None:
    from mjx_fit.viz.viewer import view

    view(_played(args), args.attempt, args.speed, args.browser, args.port, args.host)


def _played(args: argparse.Namespace) -> "Generator[Recording]":
    """What is asked for to be looked at: it is played as it is taken."""
    from mjx_fit.engines.select import make_engine
    from mjx_fit.evaluation import playback, results
    from mjx_fit.training.sensor_loader import load_trained_sensor

    asked = args.config or args.set or args.seed or args.engine != "auto"
    if args.result is not None and asked:
        raise RequestError(
            "--config, --set, --seed, --engine: cannot be combined with a result file, which stores its own"
        )
    pick = playback.Pick(args.method, args.trial, args.attempt)
    if args.result is None:
        config = _config(args)
        engine, sensor = make_engine(args.engine, config), load_trained_sensor(_run(args))
        return playback.record(config, pick, args.seed, engine, sensor)
    result = results.read(args.result)
    engine = make_engine(result.engine, config_from_stored(result.config))
    return playback.replay(result, pick, engine, load_trained_sensor(_run(args)))


def bench(args: argparse.Namespace) -> None:
    from mjx_fit.cli.bench.run import bench

    bench(_config(args, preset="paper"), args.json)


def config_keys(args: argparse.Namespace) -> None:
    from mjx_fit.config.table import as_json, as_text, keys

    table = keys(_config(args))
    print(json.dumps(as_json(table), indent=1) if args.json else as_text(table))


def info(args: argparse.Namespace) -> None:
    import jax

    from mjx_fit.engines.select import resolve
    from mjx_fit.utils import provenance

    _show(
        {
            "versions": provenance.versions(),
            "devices": [f"{device.platform}: {device.device_kind}" for device in jax.devices()],
            "engine": resolve("auto"),
        },
        args.json,
    )


def _run(args: argparse.Namespace) -> Path:
    from mjx_fit.utils import resources

    return args.run or resources.folder("weights")


def _config(args: argparse.Namespace, preset: str | None = None) -> Config:
    from mjx_fit.utils import resources
    from mjx_fit.utils.randomness import require_seed

    if hasattr(args, "seed"):  # before sensors and data are read
        require_seed(args.seed)
    preset_file = [] if preset is None else [resources.folder("configs") / f"{preset}.yaml"]
    return read_config([*preset_file, *args.config], args.set)


def _show(tree: dict, as_json: bool) -> None:
    import yaml

    print(
        json.dumps(tree, indent=1)
        if as_json
        else yaml.safe_dump(tree, sort_keys=False, allow_unicode=True).rstrip()
    )
