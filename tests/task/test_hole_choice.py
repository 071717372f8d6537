"""The next hole by insertions per second, against a plain loop."""

import numpy as np
import pytest

from mjx_fit.config.schema import Config
from mjx_fit.task.effort import move_time_s
from mjx_fit.task.hole_choice import Situation, by_rate
from mjx_fit.types import Belief


@pytest.mark.parametrize("begun", [True, False])
def test_the_hole_with_the_highest_rate_is_chosen_and_the_next_best_is_judged_from_there(begun):
    """The first move of a new peg takes no time."""
    rng, config = np.random.default_rng(5), Config()
    rows, holes = 6, 4
    match = rng.dirichlet(np.ones(3), (rows, holes))
    std = rng.uniform(0.0005, 0.01, (rows, holes))
    mean = rng.uniform(0.3, 0.6, (rows, holes, 2))
    beliefs = Belief(mean, std[..., None, None] ** 2 * np.eye(2), np.log(match))
    peg, filled = rng.integers(0, 3, rows), rng.random((rows, holes)) < 0.4
    filled[:, 0], filled[-1] = False, [False, True, True, True]
    place = rng.uniform(0.3, 0.6, (rows, 2))
    now = Situation(beliefs, peg, filled, np.full((rows, holes), int(begun)), place)
    choice, elsewhere = by_rate(now, config)

    def rate(r: int, h: int, start: np.ndarray | None) -> float:
        blind = np.pi * 2 * std[r, h] ** 2 / (config.seek.speed_mps * config.seek.pitch_m)
        search_s = 1 / (1 / blind + 1 / config.seek.feel_s) + config.seek.sink_s
        move_s = 0 if start is None else move_time_s(start[None], mean[r, h][None], config.moves)[0]
        return match[r, h, peg[r]] / (search_s + move_s)

    for r in range(rows):
        free = [h for h in range(holes) if not filled[r, h]]
        best = max(free, key=lambda h, r=r: rate(r, h, place[r] if begun else None))
        assert choice.hole[r] == best
        assert choice.chance[r] == pytest.approx(match[r, best, peg[r]])
        others = [rate(r, h, mean[r, best]) for h in free if h != best]
        assert elsewhere[r] == pytest.approx(max(others, default=0.0), rel=1e-4)
        assert np.isnan(choice.next_best[r]) == (not others)
