"""Output of measurement scripts: numbers with their provenance, and figures."""

import json
import os
import subprocess
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
    """Write results as JSON, with the command, device and versions, and print them.

    Args:
        path: Output file.
        results: Nested dicts and lists; arrays become lists. What an earlier run stored may be among them:
            its command, device and versions are replaced.
    """
    script = os.path.relpath(sys.argv[0])
    origin = {
        "command": " ".join(["python", script, *map(_without_folder, sys.argv[1:])]),
        "device": provenance.device(),
        "versions": provenance.versions(),
    }
    files.write_text(path, json.dumps(origin | results | origin, indent=1, default=_plain) + "\n")
    print(json.dumps(results, indent=1, default=_plain))


def command(*words: object) -> None:
    """Run a command of the library, which does nothing if it has finished before."""
    subprocess.run([sys.executable, "-m", "mjx_fit", *map(str, words)], check=True)


def _without_folder(argument: str) -> str:
    """Reduce an absolute path to its name: the folder is private and useless elsewhere."""
    return Path(argument).name if Path(argument).is_absolute() else argument


def draw(path: Path, make: Callable[[], Figure]) -> None:
    """Draw a figure in the common style and save it as PNG."""
    with matplotlib.rc_context(style.RC):
        make().savefig(path, dpi=110, metadata={"Software": None})
    print(path)


def _plain(value: Any) -> Any:
    return (
        np.asarray(value).tolist() if isinstance(value, np.ndarray | np.generic | jax.Array) else str(value)
    )
