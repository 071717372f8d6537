"""Train the sensor of `seek`: collect, train, collect under its own beliefs, train on; resumes where it was.

    python experiments/gentle/learn.py OUT

The first round reads spirals and random sweeps. Each later one collects attempts of `seek` with the sensor of
the round before, and trains it further on all data so far: a search that acts on its belief goes where no
spiral goes, and what the sensor feels there it has to learn there (Ross et al., "A reduction of imitation
learning and structured prediction to no-regret online learning", 2011). Half of the attempts are in the world
`paper`, half in `forge`; readings have the errors of `forge`.
"""

import argparse
from pathlib import Path

from mjx_fit.report import script

HERE = Path(__file__).parent
GENTLE = ("--config", HERE / "gentle.yaml")
WORLDS = ("paper", "forge")
EPISODES = (5000, 2500, 2500)
"""Attempts in each world and round, two at each hole."""
EPOCHS = (14, 10, 10)


def main(out: Path) -> None:
    sets: list[Path] = []
    run = None
    for number, (episodes, epochs) in enumerate(zip(EPISODES, EPOCHS, strict=True)):
        policy = ("mixed",) if run is None else ("seek", "--run", run)
        for world in WORLDS:
            sets.append(out / f"round{number}_{world}")
            seed = 31 + number
            drawn = ("--world", world, *GENTLE, "--episodes", episodes, "--sequence", 2, "--seed", seed)
            script.command("collect", "--out", sets[-1], "--policy", *policy, *drawn)
        before, run = run, out / f"run{number}"
        first = () if before is None else ("--init", before, "--set", "train.learning_rate=5e-4")
        asked = ("--world", "forge", *GENTLE, "--config", HERE / "sensor.yaml", "--epochs", epochs)
        script.command("train", "--data", *sets, "--out", run, *asked, *first)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT")
    main(parser.parse_args().out)
