"""Values reported by the paper (arXiv 2101.02725), for comparison: (method, metric, group) -> value."""

from collections.abc import Mapping
from typing import Any

from mjx_fit.config.sections.shape import SHAPES

PAPER: dict[tuple[str, str, str], float] = {
    ("spiral", "success_rate", "matched"): 0.34,
    ("failure_only", "intervention_rate", "all"): 0.264,
    ("failure_position", "intervention_rate", "all"): 0.010,
    ("full", "intervention_rate", "all"): 0.022,
}

MAX_ATTEMPTS = 30
"""Maximum number of attempts per peg before human intervention, in the paper."""


def beside(config: Mapping[str, Any]) -> dict[tuple[str, str, str], float]:
    """Return the paper's values comparable to a configuration.

    They are those of its shapes, if the names are known; the intervention rate also depends on the cap.
    """
    shapes = config.get("scene", {}).get("shapes")
    if shapes and [shape["name"] for shape in shapes] != [shape.name for shape in SHAPES]:
        return {}
    alike = config.get("task", {}).get("max_attempts") == MAX_ATTEMPTS
    return {key: value for key, value in PAPER.items() if alike or key[1] != "intervention_rate"}
