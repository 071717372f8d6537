"""Small collections, in this process with one engine for all, or in processes of their own."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from mjx_fit.config.schema import Config
from mjx_fit.data.collect import collect
from mjx_fit.data.plan import Plan
from mjx_fit.engines.interface import Engine
from mjx_fit.task.estimator import Update
from mjx_fit.utils.files import LOCK

PLAN = Plan(episodes=10, actions=3, policy="mixed", engine="native", seed=5, batch=5)


class Collector:
    """Collects with one engine, compiled once."""

    def __init__(self, native: Engine):
        self._native = native

    def __call__(
        self, out: Path, config: Config | None = None, update: Update | None = None, **changes: Any
    ) -> Path:
        collect(config or Config(), out, replace(PLAN, **changes), self._native, update)
        return out


def files_of(folder: Path) -> dict[str, bytes]:
    """What a folder holds, but for the lock, which has no content."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != LOCK}


def command(out: Path, **plan: Any) -> list[str]:
    """The command line of a collection."""
    options = [x for name, value in plan.items() for x in (f"--{name.replace('_', '-')}", str(value))]
    return [sys.executable, "-m", "mjx_fit", "collect", "--out", str(out), *options]


def run(argv: list[str], **kwargs: Any) -> subprocess.CompletedProcess[str]:
    """Runs a command to its end."""
    return subprocess.run(argv, capture_output=True, text=True, timeout=200, check=False, **kwargs)
