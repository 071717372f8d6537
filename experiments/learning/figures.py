"""Draw the figures of this page from its result files: ``python experiments/learning/figures.py``."""

from pathlib import Path

from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.evaluation import results
from mjx_fit.report import script
from mjx_fit.report.figures import calibration as figures
from mjx_fit.report.figures import training_run
from mjx_fit.utils import resources

HERE = Path(__file__).parent


def main() -> None:
    first = results.read(HERE / "calibration.json")
    several = results.read(HERE / "sequences.json")
    metrics = training_run.read_metrics(resources.folder("weights-as-2026-11") / "metrics.jsonl")
    script.draw(HERE / "curve.png", lambda: training_run.training_curve(metrics))
    script.draw(HERE / "error_by_actions.png", lambda: figures.error_by_actions(first.summary))
    script.draw(HERE / "coverage.png", lambda: figures.coverage(first.trials))
    names = SceneConfig().names
    script.draw(HERE / "match_reliability.png", lambda: figures.match_reliability(first.trials, names))
    script.draw(HERE / "match_by_pair.png", lambda: figures.match_by_pair(first.summary))
    script.draw(HERE / "error_by_attempt.png", lambda: figures.error_by_attempt(several.summary))
    script.draw(HERE / "coverage_by_attempt.png", lambda: figures.coverage_by_attempt(several.summary))


if __name__ == "__main__":
    main()
