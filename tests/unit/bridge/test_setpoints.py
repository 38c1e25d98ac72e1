"""Whole mm/s and deg/s on the wire: next to the command at every moment, the command on average."""

import math
import random

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bridge.pioneer.setpoints import Quantiser
from rover_ncp.core.geometry import Velocity


def turn_error(omega, v):
    """Return the largest error of the mean turn rate over any second, in rad/s."""
    draw, quantiser = random.Random(1), Quantiser()
    times, angles = [0.0], [0.0]
    while times[-1] < 6.0:
        _, deg_s = quantiser.step(Velocity(v, omega), times[-1])
        step = 0.05 * draw.uniform(0.8, 1.2)
        angles.append(angles[-1] + math.radians(deg_s) * step)
        times.append(times[-1] + step)
    starts = np.arange(45) / 10
    turned = np.interp(starts + 1.0, times, angles) - np.interp(starts, times, angles)
    return np.abs(turned - omega).max()


def test_mean_turn_rate_over_a_second_is_within_two_thousandths():
    rates = [k * 0.0113 for k in range(-16, 17)] + [0.0021, -0.0025, 0.59, 0.6]
    assert max(turn_error(omega, 0.1) for omega in rates) <= 0.002


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
