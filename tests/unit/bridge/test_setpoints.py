"""Whole mm/s and deg/s on the wire: next to the command at every moment, the command on average."""

import math
import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.pioneer.setpoints import Quantiser
from rover_ncp.core.geometry import Velocity


def turn_error(omega, v, period_s, jitter):
    """Return the largest error of the mean turn rate over any second, in rad/s."""
    draw, quantiser = random.Random(1), Quantiser()
    times, angles = [0.0], [0.0]
    while times[-1] < 6.0:
        _, deg_s = quantiser.step(Velocity(v, omega), times[-1])
        step = period_s * (1 + jitter * draw.uniform(-1, 1))
        angles.append(angles[-1] + math.radians(deg_s) * step)
        times.append(times[-1] + step)
    starts = np.arange(45) / 10
    turned = np.interp(starts + 1.0, times, angles) - np.interp(starts, times, angles)
    return np.abs(turned - omega).max()


@pytest.mark.parametrize("v", [0.0, 0.1])
@pytest.mark.parametrize(("period_s", "jitter"), [(0.01, 0.0), (0.02, 0.2), (0.05, 0.2), (0.1, 0.0)])
def test_mean_turn_rate_over_a_second_is_within_two_thousandths(period_s, jitter, v):
    rates = [k * 0.0113 for k in range(-16, 17)] + [0.0021, -0.0025, 0.59, 0.6]
    assert max(turn_error(omega, v, period_s, jitter) for omega in rates) <= 0.002


def test_standing_rover_gets_nothing_but_zero():
    quantiser = Quantiser()
    for k in range(40):
        quantiser.step(Velocity(0.1, 0.05), k * 0.05)
    for k in range(40, 1000):
        assert quantiser.step(Velocity(0.0015, -0.0015), k * 0.05) == (0, 0)


def test_remainder_is_dropped_when_the_rover_stands():
    quantiser = Quantiser()
    assert quantiser.step(Velocity(0.0, 0.0085), 0.0) == (0, 0)
    quantiser.step(Velocity(0.0, 0.0085), 0.9)
    quantiser.zero()
    assert [quantiser.step(Velocity(0.1, 0.0), 1.0 + 0.05 * k)[1] for k in range(20)] == [0] * 20


@given(st.lists(st.tuples(st.floats(-2, 2), st.floats(-5, 5), st.floats(0, 3)), min_size=1))
def test_each_setpoint_is_next_to_the_gates_value(commands):
    """Invariant: nothing but quantisation changes the gate's value: not a clamp, not a carried remainder."""
    quantiser, now = Quantiser(), 0.0
    for v, omega, pause in commands:
        for _ in range(3):
            mm_s, deg_s = quantiser.step(Velocity(v, omega), now)
            if abs(v) < 0.002 and abs(omega) < 0.002:
                assert (mm_s, deg_s) == (0, 0)
            else:
                assert abs(mm_s - v * 1000) <= 0.5
                assert math.floor(math.degrees(omega)) <= deg_s <= math.ceil(math.degrees(omega))
            now += pause


@given(st.floats(-0.3, 0.3), st.floats(-0.6, 0.6))
def test_first_setpoint_is_the_nearest(v, omega):
    mm_s, deg_s = Quantiser().step(Velocity(v, omega), 5.0)
    if abs(v) >= 0.002 or abs(omega) >= 0.002:
        assert abs(mm_s - v * 1000) <= 0.5
        assert abs(deg_s - math.degrees(omega)) <= 0.5
