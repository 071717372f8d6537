"""What the paper reports (arXiv 2101.02725), to stand beside ours: (method, metric, group) -> value."""

from collections.abc import Mapping
from typing import Any

PAPER: dict[tuple[str, str, str], float] = {
    ("spiral", "success_rate", "matched"): 0.34,
    ("failure_only", "intervention_rate", "all"): 0.264,
    ("failure_position", "intervention_rate", "all"): 0.010,
    ("full", "intervention_rate", "all"): 0.022,
}

MAX_ATTEMPTS = 30
"""At one peg, before a human inserts it."""


def beside(config: Mapping[str, Any]) -> dict[tuple[str, str, str], float]:
    """What may stand beside a result of this configuration: how often a human helps depends on the cap."""
    alike = config.get("task", {}).get("max_attempts") == MAX_ATTEMPTS
    return {key: value for key, value in PAPER.items() if alike or key[1] != "intervention_rate"}
