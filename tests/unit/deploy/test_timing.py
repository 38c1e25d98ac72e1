"""The schedule of ticks, and the moments of measurements, on virtual time."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deploy.drive.measurements import NS, StampClock
from deploy.drive.rate_keeper import RateKeeper

MS = 1_000_000
PERIOD = 100 * MS


def test_schedule_is_absolute_so_lateness_never_adds_up():
    keeper = RateKeeper(PERIOD, 5 * NS)
    deadline = 5 * NS - 50 * MS
    for tick in range(320):
        assert keeper.due_ns == 5 * NS + tick * PERIOD
        assert keeper.opens_ns == deadline  # windows of neighbouring ticks touch and do not overlap
        deadline = keeper.deadline_ns
        keeper.ticked(keeper.due_ns + 7 * MS, predicted=False)
    report = keeper.report()
    assert (report.ticks, report.overruns) == (320, 0)
    assert report.rate_hz == pytest.approx(10.0)
    assert report.lateness_p50_ms == report.lateness_max_ms == 7.0


def test_predicted_and_missed_ticks_are_overruns():
    keeper = RateKeeper(PERIOD, 0)
    assert set(keeper.report()) == {0}
    keeper.ticked(0, predicted=False)
    assert keeper.skip_missed(keeper.deadline_ns, 320) == 0
    keeper.ticked(keeper.deadline_ns, predicted=True)
    assert keeper.overruns == 1
    assert keeper.skip_missed(keeper.deadline_ns + PERIOD - 1, 320) == 0
    assert keeper.skip_missed(keeper.deadline_ns + 3 * PERIOD + 1, 320) == 3
    assert keeper.index == 5
    keeper.ticked(keeper.due_ns, predicted=False)
    report = keeper.report()
    assert (report.ticks, report.predicted, report.missed, report.overruns) == (3, 1, 3, 4)
    assert report.lateness_max_ms == 50.0


def test_no_tick_beyond_the_end_of_the_course_is_missed():
    keeper = RateKeeper(PERIOD, 0)
    assert keeper.skip_missed(keeper.deadline_ns + 30 * PERIOD, 10) == 10
    assert (keeper.index, keeper.missed) == (10, 10)
    assert keeper.skip_missed(keeper.deadline_ns + 5 * PERIOD, 10) == 0


delays = st.lists(st.integers(0, 300 * MS), min_size=1, max_size=50)


@given(delays=delays, zero=st.integers(-(10**18), 10**18))
def test_a_measurement_is_before_its_arrival_and_never_runs_backwards(delays, zero):
    clock, last, arrival = StampClock(), None, 0
    for number, delay in enumerate(delays):
        taken = NS + number * PERIOD
        arrival = max(arrival, taken + delay)  # one link: samples keep their order
        measured = clock.measured_ns(taken + zero, arrival)
        assert measured <= arrival
        assert last is None or measured >= last
        last = measured


@given(delays=delays)
def test_after_a_fast_sample_every_moment_is_exact(delays):
    clock = StampClock()
    clock.measured_ns(0, 1 * MS)  # the shortest transit takes 1 ms
    arrival = 1 * MS
    for number, delay in enumerate([*delays, 5 * NS], 1):
        taken = number * PERIOD
        arrival = max(arrival, taken + 1 * MS + delay)
        assert clock.measured_ns(taken, arrival) == taken + 1 * MS


def test_a_senders_clock_set_forward_or_back_makes_no_sample_younger():
    clock = StampClock()
    clock.measured_ns(0, MS)
    hour = 3600 * NS
    assert clock.measured_ns(hour + PERIOD, PERIOD + MS) == PERIOD + MS  # as young as its arrival
    assert clock.measured_ns(2 * PERIOD, 2 * PERIOD + MS) == PERIOD + MS  # keeps ageing: odometry is stale


def test_a_drifting_clock_is_followed_over_hours():
    clock, worst = StampClock(), 0
    for number in range(0, 36000, 7):  # an hour at 10 Hz, the sender slow by 100 ppm
        arrival = number * PERIOD + MS
        stamp = round(number * PERIOD * (1 - 1e-4))
        worst = max(worst, arrival - clock.measured_ns(stamp, arrival))
    assert worst <= 60 * NS * 1e-4 + MS
