"""Division of a batch among host threads."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjx_fit.engines.threads import on_threads, parts_of


@given(st.integers(0, 500), st.integers(1, 16), st.integers(1, 64))
def test_parts_cover_all_ids_once_evenly(n, threads, at_most):
    parts = parts_of(n, threads, at_most)
    assert np.array_equal(np.concatenate([*parts, []]), np.arange(n))
    sizes = [len(part) for part in parts]
    assert not sizes or (max(sizes) <= at_most and max(sizes) - min(sizes) <= 1 and min(sizes) > 0)
    assert len(parts) == n or len(parts) % threads == 0


def test_what_a_thread_raises_is_raised():
    def work(item):
        if item == 3:
            raise ValueError("three")

    with pytest.raises(ValueError, match="three"):
        on_threads(2, work, range(5))
