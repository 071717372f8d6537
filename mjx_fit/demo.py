"""The whole pipeline, small: data, training, evaluation and report within minutes on two cores."""

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from mjx_fit.config import Config
from mjx_fit.dataset.collect import collect
from mjx_fit.dataset.plan import Plan
from mjx_fit.errors import RequestError
from mjx_fit.evaluation import experiments
from mjx_fit.report.build import build
from mjx_fit.report.run_figures import read_metrics
from mjx_fit.report.terminal import print_summary
from mjx_fit.training.baseline import train_from

METHODS = "failure_only,full,oracle"
POLICY = "spiral"


@dataclass(frozen=True)
class Size:
    """How much the demo does: about eight minutes on two cores by default.

    Attributes:
        episodes: Interactions that are collected.
        steps: Most actions in one.
        attempts: Single attempts for each shape, and mismatched ones in all.
        assemblies: Trials of the assembly experiment.
    """

    episodes: int = 1500
    steps: int = 100
    attempts: int = 50
    assemblies: int = 8


def demo(config: Config, out: Path, size: Size) -> None:
    """Runs every stage into ``out``; a stage that is done is not done again.

    Raises:
        RequestError: The folder holds the demo of another configuration, or other files.
    """
    parts = {"data", "train", "attempt.json", "assembly.json", "figures", "index.html"}
    foreign = sorted({path.name for path in out.iterdir()} - parts) if out.is_dir() else []
    if foreign:
        raise RequestError(f"--out: {out} is not allowed: it holds other files ({foreign[0]})")
    console = Console(highlight=False)
    data, run = out / "data", out / "train"

    console.rule(f"1/4  {size.episodes} interactions of up to {size.steps} actions")
    collect(config, data, Plan(size.episodes, size.steps, POLICY))

    console.rule("2/4  train sensors and filters on them")
    train_from(data, config, run, seed=0)
    best = min(read_metrics(run / "metrics.jsonl"), key=lambda row: row["val_nll"])
    console.print(
        f"validation NLL: {best['val_nll']:.3f} after the update, {best['prior_nll']:.3f} before it "
        f"(epoch {best['epoch'] + 1})"
    )

    console.rule("3/4  evaluate")
    attempts = experiments.attempt(config, out / "attempt.json", size.attempts, 0, "auto")
    assemblies = experiments.assembly(config, out / "assembly.json", run, METHODS, size.assemblies, 0, "auto")
    print_summary(attempts)
    print_summary(assemblies)

    console.rule("4/4  report")
    console.print(str(build([out], out)), soft_wrap=True)
