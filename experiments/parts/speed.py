"""Measure the speed of every part in both engines, in one run with a box of the same size.

    python experiments/parts/speed.py [--engines native,mjx] [PART ...]

A row is a scene of one part in its own socket, spirals of 64 worlds; its box has the part's extents,
clearance and physics steps. Speeds are simulated over real seconds (a torque is 2 ms), small steps count.
``raw`` is MuJoCo's batch alone on the same scene and torques. Rows of other parts in ``speed.json`` are kept.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from table import scenes

from mjx_fit.cli.bench.engines import attempts_of
from mjx_fit.cli.bench.run import measure
from mjx_fit.config.schema import Config
from mjx_fit.config.sections.cross_section import CrossSection, Rectangle
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.config.sections.shape import Shape
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.report import script
from mjx_fit.scene.outline import peg_outline
from mjx_fit.utils import process_setup
from mjx_fit.utils.rates import STEP_S

FILE = Path(__file__).parent / "speed.json"
WORLDS = 64
CONTENDERS = {"native": ("raw_batch", "native"), "mjx": ("mjx_step", "mjx")}


def main(parts: list[str], engines: list[str]) -> None:
    """Measure the parts and their boxes."""
    rows = json.loads(FILE.read_text())["rows"] if FILE.exists() else {}
    for scene in scenes().values():
        for shape in scene.shapes:
            if not parts or shape.name in parts:
                rows[shape.name] = rows.get(shape.name, {}) | measured(shape, scene, engines)
                print(shape.name, rows[shape.name], flush=True)
                script.save(FILE, {"worlds": WORLDS, "rows": rows})


def measured(shape: Shape, scene: SceneConfig, engines: list[str]) -> dict[str, Any]:
    """Return speeds of a part and of its box, and the contact points of the part."""
    own, box = task_of(shape, scene), task_of(box_of(shape, scene), scene)
    found = {"physics_steps": own.scene.physics_steps, "contact_points": contact_points(own)}
    for engine in engines:
        for name in CONTENDERS[engine]:
            speed, of_box, again = (speed_of(name, one) for one in (own, box, own))
            speed = max(speed, again)
            found |= {name: round(speed, 1), f"{name}_over_box": round(speed / of_box, 3)}
    if "native" in engines:
        found["native_over_raw"] = round(found["native"] / found["raw_batch"], 3)
    if "mjx" in found and "raw_batch" in found:
        found["mjx_over_raw"] = round(found["mjx"] / found["raw_batch"], 3)
    return found


def task_of(shape: Shape, scene: SceneConfig) -> Config:
    """Return the default configuration with one part."""
    config = Config()
    task = replace(config.task, success_probability=None, success_by_error=None)
    return replace(config, scene=replace(scene, shapes=(shape,)), task=task)


def box_of(shape: Shape, scene: SceneConfig) -> Shape:
    """Return a box with the extents of a part."""
    x0, y0, x1, y1 = peg_outline(shape, scene).bounds
    section = CrossSection(rectangle=Rectangle((round(x1 - x0, 7), round(y1 - y0, 7))))
    return Shape("box", section=section, clearance_m=scene.clearance_of(shape))


def speed_of(name: str, config: Config) -> float:
    """Return simulated over real seconds, of all worlds."""
    return STEP_S * measure(name, config, WORLDS)["physics_steps_per_s"]


def contact_points(config: Config) -> float:
    """Return the mean number of contact points in C, over the samples that touch."""
    counts = []

    def look(ids: np.ndarray, batch) -> None:
        data = mujoco.MjData(engine.scene.models[0])  # pyright: ignore[reportAttributeAccessIssue]
        for i in range(len(ids)):
            batch.get_data(i, data)
            counts.append(data.ncon)

    engine = NativeEngine(config, 2, on_step=look)
    engine.run(attempts_of(config, 16), 40)
    touching = np.array(counts)
    return round(float(touching[touching > 0].mean()), 1)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", metavar="PART")
    parser.add_argument("--engines", default="native,mjx")
    asked = parser.parse_args()
    process_setup.configure()
    main(asked.parts, asked.engines.split(","))
