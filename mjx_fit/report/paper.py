"""What the paper reports (arXiv 2101.02725), to stand beside ours: (method, metric, group) -> value."""

PAPER: dict[tuple[str, str, str], float] = {
    ("spiral", "success_rate", "matched"): 0.34,
    ("failure_only", "intervention_rate", "all"): 0.264,
    ("failure_position", "intervention_rate", "all"): 0.010,
    ("full", "intervention_rate", "all"): 0.022,
}
