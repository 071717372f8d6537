"""Progress lines of long work without a terminal."""

import pytest

from mjx_fit.utils import progress
from mjx_fit.utils.progress import Progress


@pytest.fixture
def clock(monkeypatch):
    class Clock:
        now = 1000.0

        def monotonic(self):
            return self.now

    monkeypatch.setattr(progress, "time", clock := Clock())
    return clock


def test_the_time_left_goes_by_the_pace_after_the_first_part(clock, capsys):
    """90 s of compiling and one part, then 10 s for each of nine parts."""
    show = Progress("work", 10)
    for done in range(1, 11):
        clock.now += 90 if done == 1 else 10
        show(done, "fine" if done == 2 else "")
    lines = capsys.readouterr().err.splitlines()
    assert lines[:3] == [
        "work: 1/10, time left unknown",
        "work: 2/10, fine, 80 s left",
        "work: 3/10, 70 s left",
    ]
    assert lines[-1] == "work: 10/10"


def test_work_that_goes_on_does_not_count_what_was_done_before(clock, capsys):
    show = Progress("work", 100, done=90)
    for seconds, done in ((1, 90), (300, 92), (30, 94)):
        clock.now += seconds
        show(done)
    assert capsys.readouterr().err.splitlines() == [
        "work: 90/100, time left unknown",
        "work: 92/100, time left unknown",
        "work: 94/100, 90 s left",
    ]


def test_lines_come_seconds_apart_but_for_the_last(clock, capsys):
    show = Progress("work", 50)
    for done in range(1, 51):
        clock.now += 1
        show(done)
    said = [line.split()[1].rstrip(",") for line in capsys.readouterr().err.splitlines()]
    assert said == [f"{done}/50" for done in [*range(1, 50, 5), 50]]
