"""What the experiments on the physics have in common: where results go, and how they look."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
from matplotlib.figure import Figure

from mjx_fit import files, provenance, runtime
from mjx_fit.config import Config
from mjx_fit.dataset.collect import draw_places
from mjx_fit.policies import SPIRAL
from mjx_fit.randomness import root_key
from mjx_fit.report import style
from mjx_fit.types import Attempt, Interaction

FOLDER = Path(__file__).parent


def begin() -> None:
    """Sets the process up as a command of mjx_fit is."""
    runtime.configure()


def save(name: str, results: dict[str, Any]) -> None:
    """Writes ``name.json``: the results, the command, and what it ran on."""
    origin = {
        "command": " ".join(["python", f"experiments/physics/{Path(sys.argv[0]).name}", *sys.argv[1:]]),
        "device": provenance.device(),
        "versions": provenance.versions(),
    }
    text = json.dumps(origin | results, indent=1, default=_plain) + "\n"
    files.write_text(FOLDER / f"{name}.json", text)
    print(json.dumps(results, indent=1, default=_plain))


def draw(name: str, make: Callable[[], Figure]) -> None:
    """Writes ``name.png`` in the style of all figures."""
    with matplotlib.rc_context(style.RC):
        make().savefig(FOLDER / f"{name}.png", dpi=110, metadata={"Software": None})
    print(f"{FOLDER / name}.png")


def spiral_attempts(config: Config, use: str, peg: np.ndarray, hole: np.ndarray) -> Attempt:
    """Attempts of Algorithm 4 from the detector's estimates, seed 0, with these pegs and holes (n,)."""
    hole_pos, estimate, key, _ = draw_places(root_key(0, use), jnp.arange(len(peg)), config.detector)
    return Attempt(jnp.asarray(peg), jnp.asarray(hole), hole_pos, estimate, jnp.full(len(peg), SPIRAL), key)


def force(interactions: Interaction) -> np.ndarray:
    """Norm of the tared force (n, samples), N, NaN behind an interaction's end."""
    wrench = interactions.trace.wrench_sensor - interactions.tare_sensor[:, None, None]
    norm = np.linalg.norm(wrench[..., :3], axis=-1)
    real = np.arange(norm.shape[1]) < interactions.length[:, None]
    return np.where(real[..., None], norm, np.nan).reshape(len(norm), -1)


def quantiles(values: np.ndarray, levels: tuple[float, ...]) -> dict[str, float]:
    """Quantiles by name: ``q50``, ``q99.9`` ..., ``max`` for 1."""
    return {
        "max" if level == 1 else f"q{100 * level:g}": float(np.nanquantile(values, level)) for level in levels
    }


def _plain(value: Any) -> Any:
    return (
        np.asarray(value).tolist() if isinstance(value, np.ndarray | np.generic | jax.Array) else str(value)
    )
