"""The gate of the gyro: false readings, pushes that the wheels do not show, faults of the sensor."""

import functools
import math

import numpy as np
import pytest
from kit.base_odometry import reported, started
from kit.described import described

from deploy.drive.config import settings_for
from deploy.estimator.motion import BIAS
from deploy.estimator.settings import EstimatorSettings
from rover_ncp.core.geometry import Pose, Velocity, wrap_angle
from rover_ncp.robot.description import load_description

TRUE_BIAS = 0.1
NOISE_RAD = 0.0006
PERIODS = [0.1, 0.02]


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
    settings=None,
    late=lambda tick: False,
    read=lambda tick: True,
):
    """Drive with odometry and gyro; return the estimator and the error of its heading at the end.

    ``reading`` makes a reading of the gyro from the true one, ``pushed`` is a turn rate that no wheel shows.
    A ``late`` reading comes after the odometry of the same moment. The gyro reports the mean rate at ticks
    at which it is ``read``.
    """
    random, estimator = np.random.default_rng(7), started(settings)
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


@pytest.mark.parametrize("period", PERIODS)
@pytest.mark.parametrize("false_rate", [2.0, -1.3, 30.0, 1e300, math.nan, -math.inf])
@pytest.mark.parametrize("omega", [standing, turning])
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
    [lambda tick, at=at: tick == at for at in (1, 2, 3, 4, 40)]
    + [lambda tick: tick in {2, 3}, lambda tick: tick % 2, lambda tick: tick % 3, lambda tick: True],
    ids=["first", "second", "third", "fourth", "in a turn", "two", "every other", "two of three", "all"],
)
@pytest.mark.parametrize("omega", [standing, lambda t: 0.3 * math.sin(t)], ids=["standing", "turning"])
def test_late_reading_is_no_prediction_that_came_true(omega, late):
    # What is predicted for want of a reading has the bias that is assumed so far: at the start, none.
    estimator, error = drive(omega, late=late)
    assert abs(error) < 0.02
    assert abs(error) < 4.0 * math.sqrt(estimator.at(8.0).covariance[2, 2])
    assert bias(estimator, 8.0) == pytest.approx(TRUE_BIAS, abs=0.004)
    assert estimator.gyro_rejected == 0


@pytest.mark.parametrize("period", PERIODS)
@pytest.mark.parametrize("false_rate", [0.2, 0.45, 0.8])
def test_small_false_reading_stays_within_the_estimates_uncertainty(false_rate, period):
    estimator, error = drive(standing, lambda t, rate: rate + false_rate * meanwhile(t), period)
    assert abs(error) < 4.5 * math.sqrt(estimator.at(8.0).covariance[2, 2])
    assert abs(error) < 0.05
    assert not estimator.fault


@pytest.mark.parametrize("period", PERIODS)
@pytest.mark.parametrize("omega", [standing, turning])
def test_false_readings_again_and_again_do_not_turn_the_estimate(omega, period):
    estimator, error = drive(
        omega, lambda t, rate: 2.0 if t > 2.0 and t % 1.0 < 0.9 * period else rate, period, until=12.0
    )
    assert abs(error) < 0.03
    assert not estimator.fault


@pytest.mark.parametrize("period", PERIODS)
@pytest.mark.parametrize(("degrees", "seconds"), [(1.0, 0.2), (-1.0, 0.5), (4.0, 0.5)])
@pytest.mark.parametrize("omega", [standing, turning])
def test_push_turns_the_estimate_and_is_no_bias(omega, degrees, seconds, period):
    rate = math.radians(degrees) / seconds
    estimator, error = drive(omega, period=period, pushed=lambda t: rate * (5.0 < t < 5.0 + seconds))
    assert abs(error - clean(omega, period)[1]) < max(0.006, 0.25 * abs(math.radians(degrees)))
    assert bias(estimator, 8.0) == pytest.approx(TRUE_BIAS, abs=0.003)
    assert estimator.gyro_rejected == 0


@pytest.mark.parametrize("period", PERIODS)
@pytest.mark.parametrize(
    "reading",
    [
        lambda t, rate: -rate,
        lambda t, rate: TRUE_BIAS,
        lambda t, rate: 0.0 if t > 4.0 else rate,
        lambda t, rate: rate if t < 4.0 else math.nan,
        lambda t, rate: rate + (2.0 if t > 4.0 else 0.0),
        lambda t, rate: 1e300,
    ],
    ids=["reversed", "stuck from the start", "stuck", "not finite", "offset", "huge"],
)
def test_gyro_that_stays_wrong_is_a_fault(reading, period):
    estimator, error = drive(turning, reading, period, until=12.0)
    assert estimator.fault_rule == "gyro"
    assert estimator.fault.startswith("10 gyro readings rejected in a row")
    assert abs(error) < 0.8


@pytest.mark.parametrize("late", [lambda tick: False, lambda tick: tick % 8 == 0, lambda tick: True])
@pytest.mark.parametrize("every", [2, 4])
def test_slow_gyro_that_stays_wrong_is_a_fault(every, late):
    # Odometry comes between readings, too: what is predicted there is no reading that fits.
    estimator, _ = drive(
        turning, lambda t, rate: -rate, 0.05, until=12.0, late=late, read=lambda tick: tick % every == 0
    )
    assert estimator.fault_rule == "gyro"


@pytest.mark.parametrize("late", [lambda tick: False, lambda tick: True])
@pytest.mark.parametrize("every", [2, 4])
@pytest.mark.parametrize("omega", [standing, turning])
def test_slow_gyro_shows_its_bias_and_the_turn(omega, every, late):
    estimator, error = drive(omega, period=0.05, late=late, read=lambda tick: tick % every == 0)
    assert abs(error) < min(0.02, 4.0 * math.sqrt(estimator.at(8.0).covariance[2, 2]))
    assert bias(estimator, 8.0) == pytest.approx(TRUE_BIAS, abs=0.004)
    assert (estimator.gyro_rejected, estimator.fault) == (0, "")


def test_time_without_a_reading_teaches_nothing():
    deviations = []
    for end in (2, 4, 5):  # the gyro reports at 0.1 s, and a new turn begins there
        estimator, _ = drive(standing, period=0.05, until=0.05 * end, read=lambda tick: tick == 2)
        deviations.append(math.sqrt(estimator._history.at(0.05 * end)[1][BIAS, BIAS]))
    assert deviations == pytest.approx([deviations[0]] * 3, rel=0.01)


def test_noise_of_a_turn_grows_with_its_time():
    deviations = []
    for period in (0.1, 0.2):
        estimator, _ = drive(standing, period=period, until=20.0)
        deviations.append(math.sqrt(estimator._history.at(20.0)[1][BIAS, BIAS]))
    assert deviations[1] == pytest.approx(deviations[0], rel=0.1)  # the same time, half as many readings


def test_described_noise_of_a_gyro_enters_the_estimate():
    robot = load_description("turtlebot4")
    usual = EstimatorSettings().gyro_rad
    assert settings_for(None, robot).gyro_rad == usual
    noisy = described("turtlebot4", gyro={"noise_rad_s": 0.1})
    assert settings_for(None, noisy).gyro_rad == pytest.approx(0.1 * math.sqrt(0.1 / robot.gyro.rate_hz))
    random = np.random.default_rng(5)
    estimator, _ = drive(
        standing,
        lambda t, rate: rate + 0.1 * random.normal() / math.sqrt(10),
        settings=settings_for(None, noisy),
    )
    assert not estimator.fault


@pytest.mark.parametrize("seed", range(4))
def test_gyro_that_comes_late_and_unevenly_does_not_move_the_heading(seed):
    """A robot turns in pulses, as one does that has a least wheel speed. Both of its sensors are exact."""
    random = np.random.default_rng(seed)
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
