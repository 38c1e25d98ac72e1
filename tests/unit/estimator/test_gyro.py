"""The gate of the gyro: false readings, pushes that the wheels do not show, faults of the sensor."""

import functools
import math

import numpy as np
import pytest
from kit.base_odometry import reported, started

from deploy.drive.config import settings_for
from deploy.estimator.motion import BIAS
from rover_ncp.core.geometry import Pose, Velocity, wrap_angle
from rover_ncp.robot.description import load_description

TRUE_BIAS = 0.1
NOISE_RAD = 0.0006


def standing(t):
    return 0.0


def turning(t):
    return 0.3 * math.sin(t - 3.0) if t > 3.0 else 0.0


def drive(
    omega,
    reading=lambda t, rate: rate,
    period=0.1,
    until=8.0,
    pushed=standing,
    late=lambda tick: False,
    read=lambda tick: True,
):
    """Drive with odometry and gyro; return the estimator and the error of its heading at the end.

    ``reading`` makes a reading of the gyro from the true one, ``pushed`` is a turn rate that no wheel shows.
    A ``late`` reading comes after the odometry of the same moment. The gyro reports the mean rate at ticks
    at which it is ``read``.
    """
    random, estimator = np.random.default_rng(7), started()
    own = true = 0.0
    rates = []
    for tick in range(1, round(until / period) + 1):
        t = tick * period
        own += omega(t - 0.5 * period) * period
        unseen = pushed(t - 0.5 * period)
        true += (1.2 * omega(t - 0.5 * period) + unseen) * period
        noise = NOISE_RAD * math.sqrt(0.1 / period) / 0.1 * random.normal()
        rates.append(1.2 * omega(t - 0.5 * period) + unseen + TRUE_BIAS + noise)
        if read(tick):
            rate = sum(rates) / len(rates)
            rates.clear()
            if not late(tick):
                estimator.gyro(reading(t, rate), t)
        estimator.odometry(*reported(Pose(0.0, 0.0, wrap_angle(own)), Velocity(0.0, omega(t))), t)
        if late(tick) and read(tick):
            estimator.gyro(reading(t, rate), t)
        if estimator.fault:
            break
    return estimator, wrap_angle(estimator.at(t).pose.theta - true)


@functools.cache
def clean(omega, period):
    """Return a drive without a fault: its estimator and the error of its heading."""
    return drive(omega, period=period)


def meanwhile(t):
    """Whether a reading counts for the tenth of a second in which it is false."""
    return 6.0 < t - 1e-6 < 6.1


def bias(estimator, t):
    return float(estimator._history.at(t)[0][BIAS])


@pytest.mark.parametrize(
    ("omega", "false_rate", "period"),
    [(standing, 2.0, 0.1), (turning, -1.3, 0.02), (turning, 1e300, 0.1), (standing, math.nan, 0.02)],
)
def test_false_reading_is_dropped_and_counted(omega, false_rate, period):
    usual, error_without = clean(omega, period)
    estimator, error = drive(omega, lambda t, rate: false_rate if meanwhile(t) else rate, period)
    assert abs(error - error_without) < 0.005
    assert estimator.at(8.0).turn_gain == pytest.approx(usual.at(8.0).turn_gain, abs=0.02)
    assert bias(estimator, 8.0) == pytest.approx(TRUE_BIAS, abs=0.003)
    assert 1 <= estimator.gyro_rejected <= 0.1 / period + 1
    assert usual.gyro_rejected == 0
    assert not estimator.fault


@pytest.mark.parametrize(
    "late",
    [lambda tick: tick == 1, lambda tick: tick in {2, 3}, lambda tick: tick % 2, lambda tick: True],
    ids=["first", "two", "every other", "all"],
)
def test_late_reading_is_no_prediction_that_came_true(late):
    # What is predicted for want of a reading has the bias that is assumed so far: at the start, none.
    estimator, error = drive(lambda t: 0.3 * math.sin(t), late=late)
    assert abs(error) < 0.02
    assert abs(error) < 4.0 * math.sqrt(estimator.at(8.0).covariance[2, 2])
    assert bias(estimator, 8.0) == pytest.approx(TRUE_BIAS, abs=0.004)
    assert estimator.gyro_rejected == 0


@pytest.mark.parametrize(("omega", "degrees", "seconds"), [(standing, 1.0, 0.2), (turning, -4.0, 0.5)])
def test_push_turns_the_estimate_and_is_no_bias(omega, degrees, seconds):
    period, rate = 0.1, math.radians(degrees) / seconds
    estimator, error = drive(omega, period=period, pushed=lambda t: rate * (5.0 < t < 5.0 + seconds))
    assert abs(error - clean(omega, period)[1]) < max(0.006, 0.25 * abs(math.radians(degrees)))
    assert bias(estimator, 8.0) == pytest.approx(TRUE_BIAS, abs=0.003)
    assert estimator.gyro_rejected == 0


@pytest.mark.parametrize(
    "reading",
    [
        lambda t, rate: -rate,
        lambda t, rate: TRUE_BIAS,
        lambda t, rate: rate if t < 4.0 else math.nan,
        lambda t, rate: rate + (2.0 if t > 4.0 else 0.0),
    ],
    ids=["reversed", "stuck", "not finite", "offset"],
)
def test_gyro_that_stays_wrong_is_a_fault(reading):
    estimator, error = drive(turning, reading, until=12.0)
    assert estimator.fault_rule == "gyro"
    assert estimator.fault.startswith("10 gyro readings rejected in a row")
    assert abs(error) < 0.8


def test_gyro_that_comes_late_and_unevenly_does_not_move_the_heading():
    """A robot turns in pulses, as one does that has a least wheel speed. Both of its sensors are exact."""
    random = np.random.default_rng(0)
    estimator = started(settings_for(None, load_description("turtlebot4")))
    own = shown = shown_t = worst = 0.0
    period, pulses = 0.05, 0.3 * random.integers(-1, 2, 160)
    for tick in range(1, 320):
        t, omega = tick * period, pulses[tick // 2]
        before, own = own, own + omega * period
        if random.random() < 0.7:  # else its message waits until the next one, with their mean
            newest = t - period * random.integers(0, 2)
            if newest > shown_t:
                turned = (own if newest == t else before) - shown
                estimator.gyro(turned / (newest - shown_t), newest)
                shown, shown_t = shown + turned, newest
        estimator.odometry(*reported(Pose(0.0, 0.0, wrap_angle(own)), Velocity(0.0, omega)), t)
        worst = max(worst, abs(wrap_angle(estimator.at(t).pose.theta - own)))
    assert worst < 0.005


def test_a_push_that_begins_before_the_rover_turns_is_no_other_floor():
    """A push while the rover stands needs no turn gain; only two turns in a row show another floor."""
    estimator, own = started(), 0.0
    for tick in range(1, 81):
        t, rate = tick * 0.1, 0.2 if tick > 40 else 0.0
        own += rate * 0.1
        pushed = 0.4 if tick in {40, 41} else 0.0
        estimator.gyro(rate + pushed, t)
        estimator.odometry(*reported(Pose(0.0, 0.0, own), Velocity(0.0, rate)), t)
        if tick == 43:
            assert abs(estimator.at(t).turn_gain - 1.0) < 0.3
    assert not estimator.fault


@pytest.mark.parametrize("gain", [0.4, 2.0])
def test_another_floor_is_learnt_at_once_also_from_readings_older_than_odometry(gain):
    """The rover turns to and fro, so that odometry turns on between a reading and its own sample."""
    estimator, own = started(), 0.0
    for tick in range(1, 101):
        t, rate = tick * 0.1, 0.4 * math.sin(0.8 * tick * 0.1)
        own += rate * 0.1
        true = gain if tick > 60 else 1.0
        estimator.gyro(true * 0.4 * math.sin(0.8 * (t - 0.09)), t - 0.04)
        estimator.odometry(*reported(Pose(0.0, 0.0, own), Velocity(0.0, rate)), t)
        if tick > 65:
            assert 0.5 * gain < estimator.at(t).turn_gain < 1.5 * gain
    assert not estimator.fault
