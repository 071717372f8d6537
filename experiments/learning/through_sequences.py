"""Save the scores of a run trained through sequences, for comparison with the weights'.

    python experiments/learning/through_sequences.py TEST.json OWN.json RUN

Both files come from ``mjx-fit evaluate calibration --run RUN``. The script writes ``through_sequences.json``,
without the trials, next to this file.
"""

import json
import sys
from pathlib import Path

from mjx_fit.evaluation import results
from mjx_fit.report import script

METRICS = ("position_error_cm", "position_nll", "nees", "coverage_50", "coverage_90", "match_auroc")


def main(first: Path, several: Path, run: Path) -> None:
    epochs = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    scores = {
        path.stem: [
            row.to_json()
            for row in results.read(path).summary
            if row.method == "full" and row.metric in METRICS and not row.group.startswith("actions")
        ]
        for path in (first, several)
    }
    script.save(Path(__file__).parent / "through_sequences.json", {"last_epoch": epochs[-1]} | scores)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(f"usage: python {sys.argv[0]} TEST.json OWN.json RUN")
    main(*map(Path, sys.argv[1:]))
