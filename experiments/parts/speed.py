"""Measure the speed of every part in both engines, side by side with a box of the same size.

    python experiments/parts/speed.py [--engines native,mjx] [PART ...]
    python experiments/parts/speed.py --compile

A row is a scene of one part in its own socket, spirals of 64 worlds; its box has the part's extents,
clearance and physics steps. Speeds are simulated over real seconds of all worlds; each is the best of three
runs, alternating with the box's. ``raw_batch`` is MuJoCo's batch alone on the same scene and torques. Rows of
other parts in ``speed.json`` are kept. ``--compile`` measures how long MJX takes to compile scenes of 3 and
of all 11 of NIST's parts, in new processes with empty caches.
"""

import argparse
import json
import tempfile
import time
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import jax
import mujoco
import numpy as np
from table import scenes

from mjx_fit.cli.bench.engines import CONTENDERS, attempts_of
from mjx_fit.config.schema import Config
from mjx_fit.config.sections.cross_section import CrossSection, Rectangle
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.config.sections.shape import Shape
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.report import script
from mjx_fit.scene.outline import peg_outline
from mjx_fit.utils import children, process_setup
from mjx_fit.utils.rates import STEP_S

FILE = Path(__file__).parent / "speed.json"
WORLDS, ACTIONS, TIMES = 64, 10, 3
COMPILED = ("round_16", "rectangle_8", "usb")
CONTENDERS_OF = {"native": ("raw_batch", "native"), "mjx": ("mjx",)}


def main(parts: list[str], engines: list[str]) -> None:
    """Measure the parts and their boxes."""
    kept = stored()
    rows = kept.get("rows", {})
    for scene in scenes().values():
        for shape in scene.shapes:
            if not parts or shape.name in parts:
                rows[shape.name] = rows.get(shape.name, {}) | measured(shape, scene, engines)
                print(shape.name, rows[shape.name], flush=True)
                script.save(FILE, kept | {"worlds": WORLDS, "rows": rows})


def compile_times() -> None:
    """Measure cold compilation with 3 and 11 types."""
    nist = scenes()["nist"]
    few = tuple(shape for shape in nist.shapes if shape.name in COMPILED)
    seconds = {}
    for shapes in (few, nist.shapes):
        with children.worker() as process, tempfile.TemporaryDirectory() as cache:
            seconds[str(len(shapes))] = process.submit(compile_s, of_shapes(shapes, nist), cache).result()
    ratio = seconds[str(len(nist.shapes))] / seconds[str(len(few))]
    script.save(FILE, stored() | {"compile_s_by_types": seconds, "compile_ratio": round(ratio, 2)})


def compile_s(config: Config, cache: str) -> float:
    """Return by how much the first run is longer than the second, s."""
    jax.config.update("jax_compilation_cache_dir", cache)
    process_setup.configure()
    run = CONTENDERS["mjx"].prepare(config, attempts_of(config, WORLDS), 1)
    taken = []
    for _ in range(2):
        began = time.perf_counter()
        run()
        taken.append(time.perf_counter() - began)
    return round(taken[0] - taken[1], 2)


def stored() -> dict[str, Any]:
    """Return what was measured before."""
    return json.loads(FILE.read_text()) if FILE.exists() else {}


def measured(shape: Shape, scene: SceneConfig, engines: list[str]) -> dict[str, Any]:
    """Return speeds of a part and of its box, and the contact points of the part."""
    own, box = task_of(shape, scene), task_of(box_of(shape, scene), scene)
    found = {"physics_steps": own.scene.physics_steps, "contact_points": contact_points(own)}
    for name in (name for engine in engines for name in CONTENDERS_OF[engine]):
        speed, of_box = speeds(name, (own, box))
        found |= {name: round(speed, 2), f"{name}_over_box": round(speed / of_box, 3)}
    return found


def speeds(name: str, configs: tuple[Config, ...]) -> list[float]:
    """Return simulated over real seconds of all worlds, for each configuration."""
    runs = [CONTENDERS[name].prepare(one, attempts_of(one, WORLDS), ACTIONS) for one in configs]
    for run in runs:
        run()  # compile
    best = [0.0] * len(runs)
    for _, (i, run) in product(range(TIMES), enumerate(runs)):
        began = time.perf_counter()
        torques = run()
        best[i] = max(best[i], torques * STEP_S / (time.perf_counter() - began))
    return best


def task_of(shape: Shape, scene: SceneConfig) -> Config:
    """Return the default configuration with one part."""
    return of_shapes((shape,), scene)


def of_shapes(shapes: tuple[Shape, ...], scene: SceneConfig) -> Config:
    """Return the default configuration with some parts."""
    config = Config()
    task = replace(config.task, success_probability=None, success_by_error=None)
    return replace(config, scene=replace(scene, shapes=shapes), task=task)


def box_of(shape: Shape, scene: SceneConfig) -> Shape:
    """Return a box with the extents of a part."""
    x0, y0, x1, y1 = peg_outline(shape, scene).bounds
    section = CrossSection(rectangle=Rectangle((round(x1 - x0, 7), round(y1 - y0, 7))))
    return Shape("box", section=section, clearance_m=scene.clearance_of(shape))


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
    parser.add_argument("--compile", action="store_true")
    asked = parser.parse_args()
    process_setup.configure()
    if asked.compile:
        compile_times()
    else:
        main(asked.parts, asked.engines.split(","))
