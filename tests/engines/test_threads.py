"""Division of a batch among host threads."""

import threading
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjx_fit.engines.threads import OneByOne, on_threads, parts_of


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


def in_and_out(one_by_one):
    """What two threads do that stay for a while."""
    order = []

    def stay(item):
        with one_by_one.at_first("compile"):
            order.append("in")
            time.sleep(0.05)
            order.append("out")

    on_threads(2, stay, range(2))
    return order


def test_what_is_new_is_done_by_one_thread_at_a_time_and_later_by_all():
    one_by_one, both = OneByOne(), threading.Barrier(2)
    assert in_and_out(one_by_one) == ["in", "out", "in", "out"]

    def later(_):
        with one_by_one.at_first("compile"):
            both.wait(10)  # breaks, and raises, unless two are here at once

    on_threads(2, later, range(2))


def test_what_failed_at_first_is_new_still():
    one_by_one = OneByOne()
    with pytest.raises(ValueError, match="once"), one_by_one.at_first("compile"):
        raise ValueError("once")
    assert in_and_out(one_by_one) == ["in", "out", "in", "out"]
