"""The times of measurements by the stamps of another clock, on virtual time."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rover_ncp.core.clock_offset import NS_PER_S, StampClock

MS = 1_000_000
PERIOD = 100 * MS

delays = st.lists(st.integers(0, 300 * MS), min_size=1, max_size=50)


@given(delays=delays, zero=st.integers(-(10**18), 10**18))
def test_a_measurement_is_before_its_arrival_and_never_runs_backwards(delays, zero):
    clock, last, arrival = StampClock(), None, 0
    for number, delay in enumerate(delays):
        taken = NS_PER_S + number * PERIOD
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
    for number, delay in enumerate([*delays, 5 * NS_PER_S], 1):
        taken = number * PERIOD
        arrival = max(arrival, taken + 1 * MS + delay)
        assert clock.measured_ns(taken, arrival) == taken + 1 * MS


@pytest.mark.parametrize("step_s", [-3600.0, -0.2, 0.2])
def test_a_clock_that_is_set_costs_one_sample(step_s):
    clock, shown = StampClock(), []
    for number in range(10):
        stamp = number * PERIOD + (round(step_s * NS_PER_S) if number >= 5 else 0)
        measured = clock.measured_ns(NS_PER_S + stamp, number * PERIOD + MS)
        assert measured == (None if number == 5 else number * PERIOD + MS)
        shown.append(clock.set_back_s)
    assert shown[6] == pytest.approx(max(-step_s, 0.0))
    assert not any(shown[:6] + shown[7:])


def test_a_link_that_became_slow_stays_late():
    """Neither constant lateness nor a bad stamp on a slow link starts the offset anew."""
    clock, late = StampClock(), 500 * MS
    clock.measured_ns(0, MS)
    for number in range(20, 500):
        stamp = number * PERIOD - (5 * NS_PER_S if number % 50 == 0 else 0)
        measured = clock.measured_ns(stamp, number * PERIOD + MS + late)
        assert measured == (None if number % 50 == 0 else number * PERIOD + MS)
        assert clock.set_back_s == 0.0


def test_a_drifting_clock_is_followed_over_hours():
    clock, worst = StampClock(), 0
    for number in range(0, 36000, 7):  # an hour at 10 Hz, the sender slow by 100 ppm
        arrival = number * PERIOD + MS
        stamp = round(number * PERIOD * (1 - 1e-4))
        worst = max(worst, arrival - clock.measured_ns(stamp, arrival))
    assert worst <= 60 * NS_PER_S * 1e-4 + MS
