"""Share code among the physics experiments: result files, figures, attempts and forces."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from mjx_fit.config.files import read_config
from mjx_fit.config.part_sets import parts_file
from mjx_fit.config.schema import Config
from mjx_fit.config.worlds import world_file
from mjx_fit.data.schedule import draw_places
from mjx_fit.report import script
from mjx_fit.task.attempt_loop import spirals_at
from mjx_fit.types import Attempt, Rollout
from mjx_fit.utils import process_setup
from mjx_fit.utils.randomness import root_key

FOLDER = Path(__file__).parent
sys.path.append(str(FOLDER.parents[1]))  # benchmarks/ is not installed


def begin() -> None:
    """Set up the process like an mjx_fit command."""
    process_setup.configure()


def config(*changes: str) -> Config:
    """Return the configuration of ``--world``, ``--parts`` and ``--config``, the defaults without them."""
    asked = _asked()
    own = [asked.config] if asked.config else []
    return read_config([*world_file(asked.world), *parts_file(asked.parts), *own], changes)


def _asked() -> argparse.Namespace:
    parser = argparse.ArgumentParser(allow_abbrev=False)
    parser.add_argument("--world")
    parser.add_argument("--parts")
    parser.add_argument("--config", type=Path)
    return parser.parse_known_args()[0]


def _suffix() -> str:
    return "".join(f"_{name}" for name in (_asked().parts, _asked().world) if name)


def save(name: str, results: dict[str, Any]) -> None:
    """Write ``name.json``: results, command, versions and device."""
    script.save(FOLDER / f"{name}{_suffix()}.json", results)


def draw(name: str, make: Callable[[], Figure]) -> None:
    """Write ``name.png`` in the style of all figures."""
    script.draw(FOLDER / f"{name}{_suffix()}.png", make)


def spiral_attempts(config: Config, use: str, peg: np.ndarray, hole: np.ndarray) -> Attempt:
    """Draw attempts of Algorithm 4 from the detector's estimates, seed 0, with these pegs and holes (n,)."""
    places = draw_places(root_key(0, use), jnp.arange(len(peg)), config)
    return spirals_at(peg, hole, places.hole_pos_world, places.estimate_world, places.key, places.physics)


def force(rollouts: Rollout) -> np.ndarray:
    """Compute the norm of the tared force (n, samples), N; NaN after the end of an interaction."""
    wrench = rollouts.felt.trace.wrench_sensor - rollouts.felt.tare_sensor[:, None, None]
    norm = np.linalg.norm(wrench[..., :3], axis=-1)
    real = np.arange(norm.shape[1]) < rollouts.felt.length[:, None]
    return np.where(real[..., None], norm, np.nan).reshape(len(norm), -1)


def quantiles(values: np.ndarray, levels: tuple[float, ...]) -> dict[str, float]:
    """Compute quantiles by name: ``q50``, ``q99.9`` ..., ``max`` for 1."""
    return {
        "max" if level == 1 else f"q{100 * level:g}": float(np.nanquantile(values, level)) for level in levels
    }
