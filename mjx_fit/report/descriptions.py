"""What an experiment asks and what its methods know, for whoever sees a page without the guide."""

from collections.abc import Sequence

_EXPERIMENTS = {
    "attempt": "One attempt at one hole, pegs that match it and pegs that do not: how often it goes in.",
    "position": "Attempts in a row at one hole: how far the believed position is from the true one.",
    "insertion": "Attempts in a row at a hole that matches the peg, until it is in.",
    "assembly": "One peg after the other has to go into a hole of its type; neither types nor places of the "
    "holes are known for sure. After too many attempts at a peg a human puts it in.",
    "calibration": "One update from each failed attempt of a data set: how near the belief comes to the "
    "truth, and whether it is as sure as it may be.",
}
_AT_HOLES = {
    "full": "the filter, behind the learned sensor",
    "frame_by_frame": "what the sensor makes of the last attempt alone",
    "no_update": "stays with the detector's estimate",
    "sample": "draws from the first belief each time",
    "oracle": "knows the position",
}
_IN_ASSEMBLIES = {
    "failure_only": "learns from a failure only that it failed",
    "failure_position": "learns from its trace where the hole is",
    "full": "learns from its trace where the hole is and whether its type is the peg's",
    "perfect_match": "is told both after one failure, without error",
    "perfect_sensor": "is told position and type after one failure",
    "oracle": "knows all from the start",
}


def about(experiment: str) -> str:
    """What it asks; empty for one that is not known."""
    return _EXPERIMENTS.get(experiment, "")


def told(experiment: str, methods: Sequence[str]) -> list[tuple[str, str]]:
    """Of each method, once, what it knows or learns."""
    words = _IN_ASSEMBLIES if experiment == "assembly" else _AT_HOLES
    return [(method, words[method]) for method in dict.fromkeys(methods) if method in words]
