"""Command ``train``."""

import argparse
from dataclasses import replace
from pathlib import Path

from mjx_fit.cli.options import add_command, config_of, configurable, pool_of, with_cluster
from mjx_fit.cli.path_argument import path, run_path
from mjx_fit.config.sections.learning import MAX_EPOCHS
from mjx_fit.utils.errors import require


def add_train(parsers: argparse._SubParsersAction) -> None:
    """Add ``train``."""
    parser = add_command(
        parsers,
        "train",
        train,
        "train sensors and noise models; the defaults gave the weights that ship",
        resumes=True,
    )
    parser.add_argument(
        "--data", type=path, required=True, nargs="+", metavar="DIR", help="one data set or several"
    )
    parser.add_argument("--out", type=path, required=True, metavar="RUN")
    parser.add_argument(
        "--epochs", type=int, metavar="N", help="passes over the data (default: train.epochs, 30)"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="root seed (default 0)")
    parser.add_argument(
        "--members",
        type=int,
        default=1,
        metavar="K",
        help="train an ensemble of K sensors at once, into RUN/member-0, ...",
    )
    parser.add_argument(
        "--init",
        type=run_path,
        metavar="RUN",
        help="start from the sensors of another run, of the same network and shapes (default: new weights)",
    )
    parser.add_argument(
        "--tensorboard", action="store_true", help="write event files for TensorBoard into RUN as well"
    )
    with_cluster(parser)
    configurable(parser)


def train(args: argparse.Namespace) -> None:
    """Run ``train``."""
    from mjx_fit.data.manifest import read_manifest
    from mjx_fit.training import run_files
    from mjx_fit.training.ensemble import train_members
    from mjx_fit.training.journal import require_tensorboard
    from mjx_fit.training.run import Run, require_members
    from mjx_fit.training.train import train_from

    config, pool = config_of(args), pool_of(args)
    require_members(args.members)
    if args.epochs is not None:
        require("--epochs", args.epochs, 1, MAX_EPOCHS)
        config = replace(config, train=replace(config.train, epochs=args.epochs))
    for folder in args.data:
        index, of = read_manifest(folder).part
        if of > 1:
            print(f"{folder}: part {index} of {of} of a data set; data merge joins them")
    if args.tensorboard:
        require_tensorboard()
    run = Run(args.out, args.seed, args.members, args.init, tensorboard=args.tensorboard)
    if args.cluster is None:
        was_left = train_from(args.data, config, run)
    else:
        was_left = train_members(args.data, config, run, pool)
    for folder in run.folders():
        print(f"{folder}: {run_files.summary(folder)}")
        ended = run_files.ended(folder, config)
        if not was_left:
            print(f"{folder}: nothing was left to do: {ended}")
        elif ended.startswith("stopped early"):
            print(f"{folder}: {ended}")
    if not args.config:
        print(other_trainings())


def other_trainings() -> str:
    """Describe the training without a preset, and list the presets."""
    from mjx_fit.utils import resources

    folder = resources.folder("configs")
    folder = folder.relative_to(Path.cwd()) if folder.is_relative_to(Path.cwd()) else folder
    return (
        "trained with the recipe of the weights that ship; other presets, by --config: "
        f"{folder / 'quick.yaml'} (30 epochs, no frame-by-frame baseline: half the time), "
        f"{folder / 'paper.yaml'} (the paper's sensor, 5000 epochs: for an accelerator)"
    )
