import copy
import functools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.base_odometry import moved, reported, started
from kit.described import described

from deploy.drive.config import settings_for
from deploy.estimator.estimator import Estimator
from deploy.estimator.inputs import Acceptance
from rover_ncp.core.geometry import STANDSTILL, Pose, Velocity, distance, wrap_angle

DT = 0.1


@functools.cache
def manoeuvre():
    """30 s of true motion: bang-bang accelerations, full speed, turns both ways, heading past ±π."""
    pose, v, omega, rows = Pose(0.0, 0.0, 0.0), 0.0, 0.0, []
    h = 0.001
    for step in range(round(30.0 / h)):
        t = step * h
        if step % 100 == 0:
            rows.append((t, pose, Velocity(v, omega)))
        target_v = 0.16 if t % 7 < 5 else 0.0
        target_omega = 0.5 if t % 20 < 13 else -0.18
        v += max(-0.31 * h, min(0.31 * h, target_v - v))
        omega += max(-1.25 * h, min(1.25 * h, target_omega - omega))
        pose = moved(pose, h * omega, h * v)
    return rows


def test_follows_a_bases_odometry_within_its_resolution_and_without_lag():
    estimator, errors, turns = started(), [], []
    for t, pose, velocity in manoeuvre():
        assert estimator.odometry(*reported(pose, velocity), t) is Acceptance.ACCEPTED
        estimate = estimator.at(t)
        errors.append(distance(estimate.pose, pose))
        turns.append(abs(wrap_angle(estimate.pose.theta - pose.theta)))
    # 1 mm steps are 0.29 mm RMS an axis; a lag of 10 ms alone would be 1.6 mm and 5 mrad here.
    assert np.sqrt(np.mean(np.square(errors))) < 0.0006
    assert np.sqrt(np.mean(np.square(turns))) < 0.001
    assert max(errors) < 0.0025
    assert max(turns) < 0.003
    assert max(abs(pose.theta) for _, pose, _ in manoeuvre()) > 3.0  # the run does cross ±π


def test_odometry_that_waited_behind_a_pause_fits_in_spite_of_its_stamps():
    """A bridge that does not run stamps what has come meanwhile with the moment of its reading."""
    before, usual, refused, lasts_s = 0, started(), 0, 0.23
    for begin in np.arange(3.0, 20.0, 1.07):
        first = math.ceil(10 * begin)
        for t, pose, velocity in manoeuvre()[before:first]:
            usual.odometry(*reported(pose, velocity), t)
        before, estimator, arrived = first, copy.deepcopy(usual), t
        for t, pose, velocity in manoeuvre()[first : first + 10]:
            arrived = max(begin + lasts_s if begin <= t < begin + lasts_s else t, arrived + 0.0004)
            estimator.odometry(*reported(pose, velocity), arrived)
            if t > begin + lasts_s + 0.25:
                assert distance(estimator.at(arrived).pose, pose) < 0.0025
        assert not estimator.fault
        refused += estimator.rejected
    assert refused <= 2  # of more than 16 reports that came late


def test_reading_the_estimate_changes_nothing_and_its_covariance_stays_positive():
    one, other = started(), started()
    for number, (t, pose, velocity) in enumerate(manoeuvre()):
        for estimator in (one, other):
            estimator.odometry(*reported(pose, velocity), t)
        for ahead in range(number % 3):
            other.at(t + 0.05 * ahead)
        covariance = one.at(t + 0.3).covariance
        assert np.allclose(covariance, covariance.T, rtol=0, atol=1e-12)
        assert np.linalg.eigvalsh(covariance).min() > 0
    a, b = one.at(30.0), other.at(30.0)
    assert (a.pose, a.velocity) == (b.pose, b.velocity)
    assert np.array_equal(a.covariance, b.covariance)


@pytest.mark.parametrize("jump", [(0.03, 0, 0), (0, 0, 0.15), (0, 1e300, 0)])
def test_a_single_outlier_is_rejected_and_forgotten(jump):
    estimator = started()
    for tick in range(1, 20):
        outlier = tick == 10
        measured = Pose(*jump) if outlier else Pose(0.0, 0.0, 0.0)
        expected = Acceptance.OUTLIER if outlier else Acceptance.ACCEPTED
        assert estimator.odometry(measured, STANDSTILL, tick * DT) is expected
        assert distance(estimator.at(tick * DT).pose, Pose(0, 0, 0)) < 0.001
    assert estimator.rejected == 1
    assert not estimator.fault


def test_a_moved_rover_is_a_fault_that_stays_and_never_a_new_seed():
    estimator = started()
    for tick in range(1, 60):
        estimator.odometry(Pose(0.3 if tick >= 10 else 0.0, 0.0, 0.0), STANDSTILL, tick * DT)
        assert bool(estimator.fault) == (tick >= 12)
        if tick == 12:
            assert distance(estimator.at(tick * DT).pose, Pose(0, 0, 0)) < 0.001
    assert "3 odometry samples rejected in a row" in estimator.fault


@given(
    where=st.integers(0, 4),
    what=st.sampled_from([math.nan, math.inf, -math.inf]),
    others=st.lists(st.floats(-1, 1), min_size=5, max_size=5),
)
def test_values_that_are_not_finite_never_reach_the_filter(where, what, others):
    estimator, values = started(), list(others)
    values[where] = what
    before = estimator.at(1.0)
    assert estimator.odometry(Pose(*values[:3]), Velocity(*values[3:]), 0.5) is Acceptance.NOT_FINITE
    after = estimator.at(1.0)
    assert after.pose == before.pose
    assert np.array_equal(after.covariance, before.covariance)
    assert estimator.odometry(Pose(0, 0, 0), STANDSTILL, math.nan) is Acceptance.NOT_FINITE
    assert not estimator.fault
    estimator.odometry(Pose(*values[:3]), Velocity(*values[3:]), 0.5)
    assert "not finite" in estimator.fault


def test_declared_noise_does_not_move_a_standing_rover():
    speed_noise = (0.02, 0.03)
    declared = dict(zip(("noise_m_s", "noise_rad_s"), speed_noise, strict=True))
    robot = described("husky-a200", odometry=declared | {"noise_m": 0.005, "noise_rad": 0.009})
    rng, estimator = np.random.default_rng(4), Estimator(settings_for(None, robot))
    estimator.start(Pose(1.0, 2.0, 0.5), 0.0, Pose(0.0, 0.0, 0.0))
    for tick in range(1, 200):
        reported_pose = Pose(*(rng.normal(size=3) * [0.005, 0.005, 0.009]))
        velocity = Velocity(*(rng.normal(size=2) * speed_noise))
        assert estimator.odometry(reported_pose, velocity, tick * DT) is Acceptance.ACCEPTED
        assert estimator.at(tick * DT).pose == pytest.approx((1.0, 2.0, 0.5), abs=1e-9)


def test_declared_noise_does_not_hide_that_a_rover_creeps():
    noise_m, noise_m_s, v = 0.001, 0.005, 0.02
    robot = described("husky-a200", odometry={"noise_m": noise_m, "noise_m_s": noise_m_s})
    rng, estimator, dt = np.random.default_rng(4), Estimator(settings_for(None, robot)), 0.05
    estimator.start(Pose(0.0, 0.0, 0.0), 0.0, Pose(0.0, 0.0, 0.0))
    for tick in range(1, 400):
        reported = Pose(v * tick * dt + noise_m * rng.normal(), noise_m * rng.normal(), 0.0)
        estimator.odometry(reported, Velocity(v + noise_m_s * rng.normal(), 0.0), tick * dt)
        assert not estimator.fault
    assert estimator.at(400 * dt).pose.x == pytest.approx(v * 400 * dt, rel=0.05)


@pytest.mark.parametrize("gap_s", [9.0, 60.0])
def test_a_rover_that_stands_may_wait_for_long_before_its_first_odometry(gap_s):
    """A long way is planned between the start and the first sample."""
    robot = described("husky-a200", odometry={"noise_m": 0.005})
    estimator = Estimator(settings_for(None, robot))
    estimator.start(Pose(0.0, 0.0, 0.0), 0.0, Pose(3.0, 0.0, 0.5))
    assert estimator.odometry(Pose(3.0, 0.0, 0.5), STANDSTILL, gap_s) is Acceptance.ACCEPTED
    assert estimator.odometry(Pose(3.01, 0.005, 0.5), Velocity(0.1, 0.0), gap_s + 0.1) is Acceptance.ACCEPTED
    assert distance(estimator.at(gap_s + 0.1).pose, Pose(0.0, 0.0, 0.0)) < 0.02


STAMPS = st.floats(-3.0, 3.0) | st.floats(width=64)
KINDS = st.sampled_from(["odometry", "gyro", "pose"])


@given(st.lists(st.tuples(KINDS, STAMPS, st.floats(-20.0, 20.0)), max_size=8))
def test_it_answers_for_any_time_whatever_the_order_of_stamps(measurements):
    estimator = started()
    for kind, t, asked in measurements:
        if kind == "odometry":
            estimator.odometry(Pose(0.0, 0.0, 0.0), STANDSTILL, t)
        elif kind == "gyro":
            estimator.gyro(0.01, t)
        else:
            estimator.external(Pose(0.0, 0.0, 0.0), np.diag([1e-4] * 3), t)
        for moment in (asked, t) if abs(t) < 20.0 else (asked,):
            estimate = estimator.at(moment)
            assert all(map(math.isfinite, (*estimate.pose, *estimate.velocity)))
            assert np.linalg.eigvalsh(estimate.covariance).min() > -1e-9
