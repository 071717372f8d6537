"""Train the sensor of `seek` for NIST's eleven parts, in rounds as `learn.py` does.

    python experiments/gentle/learn_nist.py OUT

The same command resumes where it was. Detections are within 5 mm, and the contact is softer than the default
(`experiments/parts/nist.yaml`). Every sensor starts anew and reads all data so far.
"""

import argparse
from pathlib import Path

from learn import GENTLE, collect, train

HERE = Path(__file__).parent
NIST = (
    "--parts",
    "nist",
    *GENTLE,
    "--config",
    HERE.parent / "parts" / "nist.yaml",
    "--config",
    HERE / "nist.yaml",
)


def main(out: Path) -> None:
    spirals = collect(out, 0, 1500, "--policy", "mixed", task=NIST)
    train(out / "run0", spirals, 20, task=NIST)
    first = collect(out, 1, 1500, "--policy", "seek", "--run", out / "run0", task=NIST)
    train(out / "run1", [*spirals, *first], 14, task=NIST)
    astray = "--policy", "seek", "--run", out / "run1", "--set", "seek.astray_share=0.5"
    second = collect(out, 2, 1500, *astray, task=NIST)
    train(out / "run", [*spirals, *first, *second], 14, task=NIST)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT")
    main(parser.parse_args().out)
