"""Use your own shapes: an L and a square, from rectangles to a data set.

    python experiments/own/shape.py FOLDER [EPISODES [ACTIONS]]

``mjx-fit collect`` with a YAML file of this section does the same; all other commands, from training to
video, take that file with ``--config``. A scene has 1 to 12 shapes; α keeps its default until it is measured.
"""

import sys
from collections import Counter
from dataclasses import replace

import numpy as np

import mjx_fit as mf

# Each rectangle: lower and upper corner (x, y, x, y) in m from the tool's axis.
ELL = mf.Shape("ell", ((-0.020, -0.020, 0.000, 0.020), (0.000, -0.020, 0.020, 0.000)))
SQUARE = mf.Shape("square", ((-0.015, -0.015, 0.015, 0.015),))


def main(folder: str, episodes: int = 240, actions: int = 100) -> None:
    """Collect rollouts of both pegs at both holes."""
    config = mf.Config(scene=replace(mf.Config().scene, shapes=(ELL, SQUARE)))
    mf.collect_dataset(folder, mf.CollectionPlan(episodes, actions, "spiral"), config)
    done, names = mf.load_dataset(folder).rollout, config.scene.names
    pairs = [f"{names[p]}-{names[h]}" for p, h in zip(done.felt.peg_type, done.truth.hole_type, strict=True)]
    inserted = Counter(np.array(pairs)[np.asarray(done.truth.inserted)].tolist())
    for pair, count in sorted(Counter(pairs).items()):
        print(f"{pair}: {inserted[pair]} of {count} inserted")


if __name__ == "__main__":
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    mf.configure()
    main(sys.argv[1], *map(int, sys.argv[2:]))
