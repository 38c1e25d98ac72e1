"""Odometry as other robots send it: mean speeds, alternating steps, coarse headings, odd stamps."""

import functools
import math
from collections import deque

import numpy as np
import pytest
from kit.base_odometry import moved, started
from kit.described import described
from kit.paths import DATA
from scipy.stats import chi2

from deploy.drive.config import settings_for
from deploy.estimator.estimator import Estimator
from deploy.estimator.inputs import Acceptance
from rover_ncp.core.geometry import Pose, Velocity, distance, wrap_angle
from rover_ncp.robot.description import load_description

ORIGIN = Pose(0.0, 0.0, 0.0)
H_S, STEP_RAD, LENGTH_M = 0.01, math.radians(0.35), 6.0


@functools.cache
def drive(scale):
    """Return (time, true pose, odometry's pose and velocity) each 0.1 s; odometry scales distances."""
    pose, own, v, omega, rows = ORIGIN, ORIGIN, 0.0, 0.0, []
    for step in range(3000):
        t = step * H_S
        if step % 10 == 0:
            rows.append((t, pose, own, Velocity(scale * v, omega)))
        wanted_v = 0.3 if 2.0 < t < 28.0 and t % 7 < 5 else 0.0
        wanted_omega = (0.4 if t % 9 < 4 else -0.2) * (2.0 < t < 28.0)
        v += max(-0.3 * H_S, min(0.3 * H_S, wanted_v - v))
        omega += max(-H_S, min(H_S, wanted_omega - omega))
        pose, own = (moved(at, H_S * omega, H_S * gain * v) for at, gain in ((pose, 1.0), (own, scale)))
    return rows


def mean_speeds(rows):
    """Report speeds as their means over the last second."""
    last = deque(maxlen=10)
    for t, true, own, velocity in rows:
        last.append(velocity)
        yield t, true, own, Velocity(*np.mean(last, axis=0).tolist())


def alternating(rows):
    """Report each second pose as that of 0.025 s earlier: short and long steps."""
    before = ORIGIN
    for number, (t, true, own, velocity) in enumerate(rows):
        turned = wrap_angle(own.theta - before.theta)
        held = Pose(*(0.75 * np.array(own) + 0.25 * np.array(before)))._replace(
            theta=wrap_angle(before.theta + 0.75 * turned)
        )
        before = own
        yield t, true, held if number % 2 else own, velocity


def coarse(rows):
    """Report the heading in steps of 0.35 degrees."""
    for t, true, own, velocity in rows:
        yield t, true, own._replace(theta=wrap_angle(STEP_RAD * round(own.theta / STEP_RAD))), velocity


def all_at_once(rows):
    return mean_speeds(alternating(coarse(rows)))


HUSKY = load_description("husky-a200")
ROBOTS = {
    "husky": HUSKY,
    "undeclared": described("husky-a200", odometry={"rate_hz": 10.0, "speed_mean_s": 0.0}),
    "turtlebot": load_description("turtlebot3-burger"),
    "pioneer": load_description("p3at-sh"),
    "not described": None,
}


@pytest.mark.parametrize(
    ("robot", "form", "scale"),
    [
        ("husky", mean_speeds, 0.94),
        ("undeclared", all_at_once, 1.06),
        ("turtlebot", coarse, 1.06),
        ("pioneer", alternating, 1.0),
        ("not described", mean_speeds, 0.94),
    ],
)
def test_irregular_odometry_is_accepted_and_its_error_is_inside_the_ellipse(robot, form, scale):
    estimator = started(settings_for(None, ROBOTS[robot]))
    for t, _, own, velocity in form(drive(scale)):
        estimator.odometry(own, velocity, t)
    # Mean speeds that no description declares are found by a sample that does not fit.
    undeclared = robot != "husky" and form in (mean_speeds, all_at_once)
    assert estimator.rejected <= undeclared
    assert not estimator.fault
    true = drive(scale)[-1][1]
    estimate = estimator.at(t)
    error = np.array(estimate.pose) - true
    assert error[:2] @ np.linalg.solve(estimate.covariance[:2, :2], error[:2]) < chi2.ppf(0.95, 2)
    assert abs(error[2]) < 1.96 * math.sqrt(estimate.covariance[2, 2])
    assert math.hypot(*error[:2]) < 0.01 + abs(1.0 - scale) * LENGTH_M


@pytest.mark.parametrize("form", [iter, mean_speeds])
def test_repeated_and_backward_stamps_neither_stop_the_drive_nor_move_the_estimate(form):
    estimator = started(settings_for(None, HUSKY))
    for number, (t, true, own, velocity) in enumerate(form(drive(1.0))):
        assert estimator.odometry(own, velocity, t) is Acceptance.ACCEPTED
        if number % 7 == 3:
            assert estimator.odometry(own, velocity, t) is Acceptance.ACCEPTED
        if number % 11 == 5:
            assert estimator.odometry(own, velocity, t - 0.05) is Acceptance.OUT_OF_ORDER
        assert distance(estimator.at(t).pose, true) < 0.01
    assert not estimator.fault


def test_recorded_odometry_of_a_husky_is_accepted():
    rows = np.loadtxt(DATA / "husky_a200.csv", delimiter=",").tolist()
    estimator = Estimator(settings_for(None, HUSKY))
    estimator.start(ORIGIN, rows[0][0])
    for t, x, y, theta, v, omega in rows[1:]:
        assert estimator.odometry(Pose(x, y, theta), Velocity(v, omega), t) is Acceptance.ACCEPTED
    assert distance(estimator.at(t).pose, Pose(x, y, theta)) < 0.01
    assert (estimator.rejected, estimator.fault) == (0, "")
