"""Paths of the files that tests read."""

from pathlib import Path

TESTS = Path(__file__).parent
ROOT = TESTS.parent
EARLIER_RUN = TESTS / "earlier_run"
"""A training run that an earlier version wrote."""
EXPERIMENTS = ROOT / "experiments"
