"""Train the sensor of the bench: spirals and sweeps that also turn, then attempts under its own beliefs.

    python experiments/bench/learn.py OUT [--stage N]

The same command resumes where it was; `--stage` ends after stage N of 3, each of about an hour on two cores.
All attempts are in the world `bench`, whose searches rock the tool. The second set does so more, so that yaw
and tilt meet the hole in many ways; later spirals and `seek` start from the sensor's beliefs, up to five
attempts at a hole. In the last attempts of `seek` half of the spells are led astray, as in
experiments/gentle/learn.py. Each sensor starts anew and reads all data so far.
"""

import argparse
from pathlib import Path

from mjx_fit.report import script

HERE = Path(__file__).parent
TASK = "--world", "bench", "--config", "configs/gentle.yaml", "--set", "filter.reads=sensor"
AS_SAID = ("filter.position_temperature=1", "filter.match_temperature=1", "task.revisit_from=belief")
"""Beliefs of the data are the sensor's own: the factors of the preset belong to another one."""
TURNING = ("spiral.yaw_rad=0.15", "spiral.tilt_rad=0.15", "random.yaw_rad=0.15", "random.tilt_rad=0.1")


def main(out: Path, stage: int) -> None:
    first = [
        collect(out, "spirals", 51, 12000, 2, "--policy", "spiral"),
        collect(out, "turning", 52, 6000, 2, "--policy", "mixed", *set_to(TURNING)),
    ]
    train(out / "run0", first)
    if stage == 1:
        return
    second = [
        collect(out, "spirals1", 53, 4000, 5, "--policy", "spiral", "--run", out / "run0"),
        collect(out, "seek1", 54, 4000, 2, "--policy", "seek", "--run", out / "run0"),
    ]
    train(out / "run1", [*first, *second])
    if stage == 2:
        return
    astray = "--set", "seek.astray_share=0.5"
    third = [
        collect(out, "spirals2", 55, 4000, 5, "--policy", "spiral", "--run", out / "run1"),
        collect(out, "seek2", 56, 4000, 3, "--policy", "seek", "--run", out / "run1", *astray),
    ]
    train(out / "run", [*first, *second, *third])


def collect(out: Path, name: str, seed: int, episodes: int, attempts: int, *options: object) -> Path:
    """Collect attempts, several at each hole, and return the data set."""
    drawn = "--episodes", episodes, "--sequence", attempts, "--seed", seed
    script.command("collect", "--out", out / name, *TASK, *set_to(AS_SAID), *drawn, *options)
    return out / name


def set_to(keys: tuple[str, ...]) -> list[str]:
    """Return the options that set these keys."""
    return [word for key in keys for word in ("--set", key)]


def train(run: Path, sets: list[Path]) -> None:
    """Train a sensor that reads attempts in progress."""
    config = *TASK, "--config", HERE.parent / "gentle" / "sensor.yaml"
    script.command("train", "--data", *sets, "--out", run, *config)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("--stage", type=int, default=3, choices=(1, 2, 3), metavar="N")
    asked = parser.parse_args()
    main(asked.out, asked.stage)
