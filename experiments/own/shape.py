"""A shape of one's own: an L and a square, from boxes to data.

    python experiments/own/shape.py FOLDER [EPISODES [ACTIONS]]

The same as ``mjx-fit collect`` with a YAML file of this section; everything else, from training to video,
takes that file by ``--config``. There may be 1 to 12 shapes; α is their default until it is measured.
"""

import sys
from pathlib import Path

from mjx_fit import runtime
from mjx_fit.config import Config
from mjx_fit.dataset.collect import collect
from mjx_fit.dataset.plan import Plan
from mjx_fit.dataset.store import describe
from mjx_fit.settings import SceneConfig, Shape
from mjx_fit.simulate.select import make_engine

# Each rectangle from its lower to its upper corner, x, y, x, y in m from the tool's axis.
ELL = Shape("ell", ((-0.020, -0.020, 0.000, 0.020), (0.000, -0.020, 0.020, 0.000)))
SQUARE = Shape("square", ((-0.015, -0.015, 0.015, 0.015),))


def main(folder: Path, episodes: int = 240, steps: int = 100) -> None:
    """Collect interactions of both pegs with both holes."""
    config = Config(scene=SceneConfig(shapes=(ELL, SQUARE)))
    collect(config, folder, Plan(episodes, steps, "spiral"), make_engine("auto", config))
    for pair, row in describe(folder)["pairs"].items():
        print(f"{pair}: {row['inserted']} of {row['episodes']} inserted")


if __name__ == "__main__":
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    runtime.configure()
    main(Path(sys.argv[1]), *map(int, sys.argv[2:]))
