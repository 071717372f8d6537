"""Measure where the time of a physics step goes in C, for parts and for the boxes of their sizes.

    python experiments/parts/stages.py

As ``experiments/robust/step_stages.py``, which has the method. Results are in ``stages.json``.
"""

import sys
from pathlib import Path

from speed import box_of, task_of
from table import HERE, scenes

from mjx_fit.report import script
from mjx_fit.utils import process_setup

sys.path.append(str(Path(__file__).parents[1] / "robust"))
from step_stages import stages  # pyright: ignore[reportMissingImports]

PARTS = ("hexagon", "star", "round_8", "tube")


def main() -> None:
    """Measure the parts, and their boxes."""
    configs = {}
    for scene in scenes().values():
        for shape in scene.shapes:
            if shape.name in PARTS:
                configs |= {shape.name: task_of(shape, scene)}
                configs |= {f"box of {shape.name}": task_of(box_of(shape, scene), scene)}
    script.save(HERE / "stages.json", stages(configs))


if __name__ == "__main__":
    process_setup.configure()
    main()
