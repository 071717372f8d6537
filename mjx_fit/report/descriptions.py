"""Short descriptions of experiments and methods, for readers of a page without the guide."""

from collections.abc import Sequence

_EXPERIMENTS = {
    "attempt": "Success rate of single attempts at one hole, for matching and mismatched pegs.",
    "position": "Error of the estimated hole position over consecutive attempts at one hole.",
    "insertion": "Number of consecutive attempts at a matching hole until the peg is inserted; a failed "
    "trial counts one attempt more than the maximum.",
    "assembly": "The robot inserts one peg after another into a hole of its type; type and position of each "
    "hole are uncertain. A human intervenes when a peg reaches the maximum number of attempts.",
    "robustness": "Position error, calibration and match classification over consecutive attempts at one "
    "hole, in perturbed worlds and with perturbed readings; the same holes throughout.",
    "calibration": "Posterior after one update from each failed attempt of a data set: its error, and "
    "whether it is calibrated.",
}
_AT_HOLES = {
    "full": "fuses the learned sensor's measurements of all attempts",
    "position_only": "fuses what the sensor says about x and y, ignores yaw, tilt and the grasp",
    "frame_by_frame": "uses the sensor's measurement of the last attempt only",
    "no_update": "keeps the detector's estimate",
    "sample": "samples from the prior at each attempt",
    "oracle": "knows the true position",
}
_IN_ASSEMBLIES = {
    "failure_only": "uses only the fact that an attempt failed",
    "failure_position": "estimates the hole position from the trace of a failed attempt",
    "full": "estimates hole position and match from the trace of a failed attempt",
    "perfect_match": "is given the true position and match after one failed attempt",
    "perfect_sensor": "is given the true position and type after one failed attempt",
    "oracle": "knows all positions and types from the start",
}


def about(experiment: str) -> str:
    """Return the description of an experiment; empty if unknown."""
    return _EXPERIMENTS.get(experiment, "")


def told(experiment: str, methods: Sequence[str]) -> list[tuple[str, str]]:
    """Return each known method, once, with what it knows or learns."""
    words = _IN_ASSEMBLIES if experiment == "assembly" else _AT_HOLES
    return [(method, words[method]) for method in dict.fromkeys(methods) if method in words]
