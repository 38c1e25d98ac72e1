"""Whole degrees a second on the wire, the commanded turn on average."""

import math
import random
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.pioneer.quantise import MotionLimits, Setpoints

LIMITS = MotionLimits(v=0.3, omega=0.6)


def turn_error(omega: float, v: float, period_s: float, jitter: float) -> float:
    """Return the largest error of the mean turn rate over any second, in rad/s."""
    draw, points = random.Random(1), Setpoints(LIMITS)
    now, turned, sent = 0.0, [(0.0, 0.0)], 0.0
    while now < 6.0:
        points.command(v, omega)
        _, deg_s = points.step(now)
        step = period_s * (1 + jitter * draw.uniform(-1, 1))
        sent += math.radians(deg_s) * step
        now += step
        turned.append((now, sent))

    def angle(t: float) -> float:
        for (t0, a0), (t1, a1) in pairwise(turned):
            if t0 <= t <= t1:
                return a0 + (a1 - a0) * (t - t0) / (t1 - t0)
        raise AssertionError

    return max(abs(angle(t / 10 + 1) - angle(t / 10) - omega) for t in range(45))


@pytest.mark.parametrize("v", [0.0, 0.1])
@pytest.mark.parametrize(("period_s", "jitter"), [(0.01, 0.0), (0.02, 0.2), (0.05, 0.2), (0.1, 0.0)])
def test_the_mean_turn_rate_over_a_second_is_within_two_thousandths(
    period_s: float, jitter: float, v: float
) -> None:
    rates = [k * 0.0113 for k in range(-16, 17)] + [0.0021, -0.0025, 0.59, 0.6]
    assert max(turn_error(omega, v, period_s, jitter) for omega in rates) <= 0.002


def test_a_standing_rover_is_sent_nothing_but_zero() -> None:
    points = Setpoints(LIMITS)
    points.command(0.1, 0.05)
    for k in range(40):
        points.step(k * 0.05)
    for k in range(40, 1000):
        points.command(0.0015, -0.0015)
        assert points.step(k * 0.05) == (0, 0)


def test_what_was_left_over_is_forgotten_when_the_rover_stands() -> None:
    points = Setpoints(LIMITS)
    points.command(0.0, 0.0085)
    assert points.step(0.0) == (0, 0)
    points.step(0.9)
    points.zero()
    points.command(0.1, 0.0)
    assert [points.step(1.0 + 0.05 * k)[1] for k in range(20)] == [0] * 20


@given(st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(0, 3)), min_size=1))
def test_no_set_point_is_beyond_the_limits(commands: list[tuple[float, float, float]]) -> None:
    """Invariant: |VEL| ≤ the limit in mm/s and |RVEL| ≤ the whole degree a second above the limit."""
    points, now = Setpoints(LIMITS), 0.0
    for v, omega, pause in commands:
        points.command(v, omega)
        for _ in range(3):
            mm_s, deg_s = points.step(now)
            assert abs(mm_s) <= 300
            assert abs(deg_s) <= 35
            now += pause


@given(st.floats(-0.3, 0.3), st.floats(-0.6, 0.6))
def test_a_command_is_sent_at_once_and_rounded_by_less_than_one(v: float, omega: float) -> None:
    points = Setpoints(LIMITS)
    points.command(v, omega)
    mm_s, deg_s = points.step(5.0)
    if abs(v) < 0.002 and abs(omega) < 0.002:
        assert (mm_s, deg_s) == (0, 0)
    else:
        assert abs(mm_s - v * 1000) <= 0.5
        assert abs(deg_s - math.degrees(omega)) <= 0.5


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_command_that_is_not_finite_is_refused_and_changes_nothing(bad: float) -> None:
    points = Setpoints(LIMITS)
    points.command(0.1, 0.0)
    for command in ((bad, 0.0), (0.0, bad)):
        with pytest.raises(ValueError, match="finite"):
            points.command(*command)
    assert points.step(0.0) == (100, 0)
