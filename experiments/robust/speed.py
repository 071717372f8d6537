"""Measure the speed of each engine by world, in turns in one process: what randomised physics costs.

    python experiments/robust/speed.py [--rounds N]

The same spirals run in every world; a step counts while its attempt lasts. ``drawn`` draws the quantities of
``forge``, each from a single value, that of ``home``: the same physics, stored and simulated as those of
random worlds. ``ratio`` is to ``home``, paired by round: its median, smallest and largest value.
"""

import argparse
import itertools
import time
from pathlib import Path

import jax
import numpy as np

from mjx_fit.config.files import read_config
from mjx_fit.config.quantities import QUANTITIES
from mjx_fit.config.randomized import distributions
from mjx_fit.config.schema import Config, config_from_tree, config_to_tree
from mjx_fit.config.worlds import world_file
from mjx_fit.data.schedule import draw_attempts
from mjx_fit.engines.interface import Engine
from mjx_fit.engines.select import make_engine
from mjx_fit.report import script
from mjx_fit.types import Attempt
from mjx_fit.utils import process_setup
from mjx_fit.utils.rates import SUBSTEPS

DRAWN = "drawn"
WORLDS = ("home", DRAWN, "forge", "wide", "as-2026-11")
"""Presets, and ``drawn``; the first is the reference."""
SIZES = {"native": (256, 40), "mjx": (64, 10)}
"""Worlds and actions by engine."""


def main(rounds: int) -> None:
    results = {}
    for name, (worlds, actions) in SIZES.items():
        speeds = _in_turns(name, worlds, actions, rounds)
        results[name] = {
            "worlds": worlds,
            "actions": actions,
            "by_world": {world: _compared(speeds[world], speeds[WORLDS[0]]) for world in WORLDS},
        }
    script.save(Path(__file__).with_suffix(".json"), {"rounds": rounds} | results)


def _in_turns(name: str, worlds: int, actions: int, rounds: int) -> dict[str, np.ndarray]:
    """Return the physics steps per second of each round by world, after a round that compiles."""
    prepared = {}
    for world in WORLDS:
        config = _drawn() if world == DRAWN else read_config(world_file(world))
        attempts = draw_attempts(jax.random.key(0), np.arange(worlds), policy="spiral", config=config)
        prepared[world] = make_engine(name, config), attempts
    speeds = {world: [] for world in WORLDS}
    for turn, world in itertools.product(range(rounds + 1), WORLDS):
        engine, attempts = prepared[world]
        speed = _speed(engine, attempts, actions)
        if turn:
            speeds[world].append(speed)
    return {world: np.array(values) for world, values in speeds.items()}


def _drawn() -> Config:
    home = config_to_tree(read_config(world_file("home")))
    randomize = distributions(read_config(world_file("forge")).randomize, QUANTITIES)
    home["randomize"] |= {name: {"choice": [home[QUANTITIES[name].section][name]]} for name in randomize}
    return config_from_tree(home)


def _speed(engine: Engine, attempts: Attempt, actions: int) -> float:
    began = time.perf_counter()
    done = engine.run(attempts, actions)
    made = SUBSTEPS * int(np.sum(np.asarray(done.felt.length)))
    return made / (time.perf_counter() - began)


def _compared(speed: np.ndarray, reference: np.ndarray) -> dict[str, object]:
    ratio = speed / reference
    return {
        "steps_per_s": round(float(np.median(speed))),
        "ratio": [round(float(value), 3) for value in (np.median(ratio), ratio.min(), ratio.max())],
    }


if __name__ == "__main__":
    process_setup.configure()
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=7)
    main(parser.parse_args().rounds)
