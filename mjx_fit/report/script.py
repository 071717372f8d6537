"""What a script of measurements leaves behind: numbers that say where they come from, and pictures."""

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import matplotlib
import numpy as np
from matplotlib.figure import Figure

from mjx_fit.report.figures import style
from mjx_fit.utils import files, provenance


def save(path: Path, results: dict[str, Any]) -> None:
    """Writes results as JSON, with the command and what it ran on, and prints them.

    Args:
        path: The file.
        results: Nested dicts and lists; arrays become lists.
    """
    script = os.path.relpath(sys.argv[0])
    origin = {
        "command": " ".join(["python", script, *map(_without_folder, sys.argv[1:])]),
        "device": provenance.device(),
        "versions": provenance.versions(),
    }
    files.write_text(path, json.dumps(origin | results, indent=1, default=_plain) + "\n")
    print(json.dumps(results, indent=1, default=_plain))


def _without_folder(argument: str) -> str:
    """A path by its name alone: where it lay is nobody's business and of no use elsewhere."""
    return Path(argument).name if Path(argument).is_absolute() else argument


def draw(path: Path, make: Callable[[], Figure]) -> None:
    """Draws a figure in the style of all figures into a PNG file."""
    with matplotlib.rc_context(style.RC):
        make().savefig(path, dpi=110, metadata={"Software": None})
    print(path)


def _plain(value: Any) -> Any:
    return (
        np.asarray(value).tolist() if isinstance(value, np.ndarray | np.generic | jax.Array) else str(value)
    )
