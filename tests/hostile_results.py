"""Hostile result files: valid ones, changed in one place or several."""

import copy
import json
import random
from typing import Any

from places import EXPERIMENTS

RIGHT = {
    "assembly": EXPERIMENTS / "paper" / "as-2026-11" / "assembly.json",
    "attempt": EXPERIMENTS / "paper" / "as-2026-11" / "attempt.json",
    "calibration": EXPERIMENTS / "learning" / "sequences.json",
    "insertion": EXPERIMENTS / "paper" / "as-2026-11" / "insertion.json",
    "position": EXPERIMENTS / "paper" / "as-2026-11" / "position.json",
}
TRIALS = 3
"""Of each method: enough for everything that is drawn, and fast."""

DEEP: Any = []
for _ in range(40):
    DEEP = [DEEP]
VALUES = [
    None, True, 0, 1, -1, 99, 10**18, 1e12, -1e12, 1e308, 0.5, "", " ", "full", "prior", "square", "²",
    "x" * 1000, "[/red]", "$\\frac{", "<script>", "a\x00b", "\x1b[2J", "\u202eevil", "attempt:1", "attempt:x",
    "9" * 50, [], {}, [[]], [99], [[99]], [None], {"a": 1}, DEEP,
]  # fmt: skip


def right(experiment: str) -> dict[str, Any]:
    """A result of ours with few trials."""
    tree = json.loads(RIGHT[experiment].read_text())
    of_method: dict[str, list[Any]] = {}
    for trial in tree["trials"]:
        key = trial.get("method", "") + str("pair" in trial and trial["pair"][0] == trial["pair"][1])
        of_method.setdefault(key, []).append(trial)
    tree["trials"] = [trial for own in of_method.values() for trial in own[:TRIALS]]
    if "trials" in tree.get("request", {}):
        tree["request"]["trials"] = TRIALS
    return tree


def changed(tree: dict[str, Any], rng: random.Random) -> dict[str, Any]:
    """The tree with one to three places dropped, doubled, cut, or put in another's place."""
    tree = copy.deepcopy(tree)
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        holder, key = _somewhere(tree, rng)
        _change(holder, key, rng)
    return tree


def _change(holder: Any, key: Any, rng: random.Random) -> None:
    value = holder[key]
    kind = rng.randrange(6)
    if kind == 0:
        del holder[key]
    elif kind == 1 and isinstance(holder, list):
        holder.insert(key, copy.deepcopy(value))
    elif kind == 2 and isinstance(value, list) and value:
        holder[key] = value[: rng.randrange(len(value))]
    elif kind == 3 and isinstance(value, int | float) and not isinstance(value, bool):
        holder[key] = rng.choice([-value, value + 1, value * 10**6, float(value), str(value), value - 1])
    elif kind == 4 and isinstance(value, list) and value:
        holder[key] = [*value, *value]
    else:
        holder[key] = copy.deepcopy(rng.choice(VALUES))


def _somewhere(tree: Any, rng: random.Random) -> tuple[Any, Any]:
    """A place at a random depth; where trials and rows are as likely as what is above them."""
    often = [name for name in ("trials", "trials", "trials", "summary", "summary") if name in tree]
    holder, key = tree, rng.choice([*tree, *often])
    while isinstance(holder[key], list | dict) and holder[key] and rng.random() < 0.85:
        holder = holder[key]
        key = rng.choice(list(holder)) if isinstance(holder, dict) else rng.randrange(len(holder))
    return holder, key
