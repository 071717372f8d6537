"""The sample that is in the repository: what was written once must stay readable."""

import numpy as np
from places import EXPERIMENTS

from mjx_fit.data import reader

SAMPLE = EXPERIMENTS / "data" / "sample"


def test_the_sample_is_whole_small_and_says_what_it_holds():
    assert reader.damages(SAMPLE) == {}
    told = reader.describe(SAMPLE)
    assert (told["episodes"], told["sequences"], told["policy"]) == (24, 12, "mixed")
    assert told["bytes"] < 3e6
    data = reader.load(SAMPLE)
    assert data.rollout.felt.trace.wrench_sensor.shape == (24, 100, 50, 6)
    assert np.linalg.eigvalsh(data.estimate_cov).min() > 0
