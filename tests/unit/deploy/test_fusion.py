"""Estimator on simulated rovers: external poses and a gyro beside odometry that is wrong in all its ways."""

import math

import numpy as np
import pytest
from base_odometry import reported
from scipy.stats import chi2

from deploy.estimator.course_filter import CourseFilter
from deploy.estimator.estimator import Estimator
from deploy.estimator.settings import EstimatorSettings, Outcome
from rover_ncp.core.geometry import Pose, Velocity, compose, distance, inverse, relative, wrap_angle
from rover_ncp.course.random_course import random_course
from sim.world.fleet import Fleet
from sim.world.randomization import (
    BaseErrors,
    OdometryErrors,
    Randomization,
    apply_base_errors,
    dead_reckon,
    draw_trials,
    trial_model,
)
from sim.world.rover import RoverModel

DT = 0.1
SETTINGS = EstimatorSettings()
TICKS = 60
REST_TICKS = 20
SIGMA = np.array([0.005, 0.005, math.radians(0.5)])
COVARIANCE = np.diag(SIGMA**2)
DECLARED = Randomization(
    name="declared",
    start_m=0.1,
    start_rad=0.17,
    delay_v_s=(0.05, 0.3),
    delay_omega_s=(0.05, 0.3),
    acceleration=0.3,
    gain=0.1,
    odometry_scale=0.03,
    noise_m=SIGMA[0],
    noise_rad=SIGMA[2],
    imbalance_rad_m=0.03,
    drift_rad_s=math.radians(0.05),
)
"""Ranges of a base's errors by the estimator's settings."""


class Drives:
    """N rovers on random courses without feedback, with their odometry and external poses."""

    def __init__(self, ranges, seed, count, turn_spread=1.0):
        model = RoverModel()
        trials = draw_trials(ranges, model, seed, count=count, ticks=TICKS)
        rng = np.random.default_rng(seed)
        self.noise, self.turn = trials.noise, np.zeros((TICKS + 1, count))
        odometry = trials.odometry.copy()
        odometry[:, 1] = 1 + turn_spread * (odometry[:, 1] - 1)
        fleet = Fleet([trial_model(model, trials, row) for row in range(count)])
        for row in range(count):
            fleet.place(row, Pose(*trials.start[row]))
        asked = [random_course(seed, row)[1].motion[20:] for row in range(count)]
        poses = [[Pose(*start) for start in trials.start]]
        wander = (SETTINGS.wander_m, SETTINGS.wander_rad, SETTINGS.skid_rad)
        believed = [Pose(1.0, -2.0, 3.0)] * count
        self.odometry = [believed]
        for tick in range(TICKS):
            commands = [
                apply_base_errors(
                    *asked[row][tick],
                    BaseErrors(*trials.gain[row], trials.imbalance[row], trials.slip[row]),
                )
                for row in range(count)
            ]
            columns = fleet.tick(np.array(commands).T)
            poses.append([Pose(*column) for column in columns.T.tolist()])
            moved = []
            for row in range(count):
                errors = OdometryErrors(
                    *odometry[row], trials.imbalance[row], trials.slip[row], trials.drift[row]
                )
                after = dead_reckon(believed[row], poses[-2][row], poses[-1][row], errors)
                way = relative(poses[-2][row], poses[-1][row])
                length, n = math.hypot(way.x, way.y), rng.normal(size=3)
                stray = Pose(
                    n[0] * wander[0] * math.sqrt(length),
                    n[1] * wander[0] * math.sqrt(length),
                    n[2] * math.sqrt(wander[1] ** 2 * length + wander[2] ** 2 * abs(way.theta)),
                )
                moved.append(compose(after, stray))
            believed = moved
            self.odometry.append(believed)
        self.poses = poses

    def seen(self, tick, row):
        x, y, theta = np.array(self.poses[tick][row]) + self.noise[row, tick]
        return Pose(x, y, wrap_angle(theta))


def follow(drives, row, every=5, late=lambda tick: 0, gyro=None):
    """Run an estimator along one drive, with a pose each so many ticks that comes ``late`` ticks later.

    Returns errors and NEES of each tick, and the estimator.
    """
    estimator = Estimator(SETTINGS)
    rest_ticks = 0 if gyro is None else REST_TICKS
    estimator.start(drives.seen(0, row), -rest_ticks * DT, drives.odometry[0][row], COVARIANCE)
    for tick in range(1 - rest_ticks, 1):
        estimator.gyro(gyro[tick + TICKS + rest_ticks][row], tick * DT)
        report = reported(drives.odometry[0][row], Velocity(0.0, 0.0))
        assert estimator.odometry(*report, tick * DT) is Outcome.ACCEPTED
    errors, nees, coming = [], [], []
    for tick in range(1, TICKS + 1):
        t = tick * DT
        before, now = drives.odometry[tick - 1][row], drives.odometry[tick][row]
        way = relative(before, now)
        if gyro is not None:
            estimator.gyro(gyro[tick][row], t)
        report = reported(now, Velocity(way.x / DT, way.theta / DT))
        assert estimator.odometry(*report, t) is Outcome.ACCEPTED
        if every and tick % every == 0:
            coming.append((tick + late(tick), tick))
        for due, measured in list(coming):
            if due <= tick:
                coming.remove((due, measured))
                estimator.external(drives.seen(measured, row), COVARIANCE, measured * DT)
        estimate = estimator.at(t)
        error = np.array(estimate.pose) - drives.poses[tick][row]
        error[2] = wrap_angle(error[2])
        errors.append(error)
        nees.append(error @ np.linalg.solve(estimate.covariance[:3, :3], error))
    return np.array(errors), np.array(nees), estimator


def raw_errors(drives, row):
    """The error of odometry alone, from the external start pose."""
    course_odom = compose(drives.seen(0, row), inverse(drives.odometry[0][row]))
    return [
        (distance(compose(course_odom, odometry[row]), poses[row]))
        for odometry, poses in zip(drives.odometry[1:], drives.poses[1:], strict=True)
    ]


def rms(errors):
    return float(np.sqrt(np.mean(np.square(errors))))


@pytest.fixture(scope="module")
def drives():
    return Drives(DECLARED, seed=1, count=200, turn_spread=SETTINGS.turn_scale * math.sqrt(3) / 0.03)


def band(degrees, count, share=0.95):
    """Range that holds the mean of ``count`` draws of χ² with this probability."""
    return chi2.ppf([(1 - share) / 2, (1 + share) / 2], degrees * count) / count


def test_over_200_random_runs_it_is_consistent_and_better_than_odometry(drives):
    runs = [follow(drives, row) for row in range(200)]
    nees = np.array([run[1] for run in runs])
    low, high = band(3, 200)  # as if the ticks of a run were one
    assert low < nees.mean() < high
    low, high = band(3, 200, 0.999)
    assert ((nees.mean(axis=0) > low) & (nees.mean(axis=0) < high)).all()
    inside = (nees > chi2.ppf(0.025, 3)) & (nees < chi2.ppf(0.975, 3))
    assert 0.94 < inside.mean() < 0.96
    assert not any(run[2].fault for run in runs)
    assert sum(run[2].poses[Outcome.OUTLIER] for run in runs) <= 2  # 1 in 10,000 of 3,200

    seen = SIGMA[:2].max() * math.sqrt(2)
    better = rms([np.hypot(*run[0][:, :2].T) for run in runs])
    assert better < 0.5 * rms([raw_errors(drives, row) for row in range(200)])
    assert better < 0.6 * seen  # nor would the poses alone do


def test_with_odometry_alone_the_estimate_is_odometry_with_its_covariance(drives):
    runs = [follow(drives, row, every=0) for row in range(60)]
    alone = rms([np.hypot(*run[0][:, :2].T) for run in runs])
    assert alone == pytest.approx(rms([raw_errors(drives, row) for row in range(60)]), rel=0.01)
    low, high = band(3, 60)
    assert low < np.mean([run[1] for run in runs]) < high


def test_corrections_from_poses_outlast_them(drives):
    """Poses on two thirds of the way: after them, the estimate is better than odometry alone."""
    begin = 40
    gained = []
    for row in range(40):
        estimator = Estimator(SETTINGS)
        estimator.start(drives.seen(0, row), 0.0, drives.odometry[0][row], COVARIANCE)
        for tick in range(1, TICKS + 1):
            before, now = drives.odometry[tick - 1][row], drives.odometry[tick][row]
            way = relative(before, now)
            estimator.odometry(*reported(now, Velocity(way.x / DT, way.theta / DT)), tick * DT)
            if tick <= begin:
                estimator.external(Pose(*drives.poses[tick][row]), 1e-8 * np.eye(3), tick * DT)
        truth = relative(drives.poses[begin][row], drives.poses[TICKS][row])
        believed = relative(drives.odometry[begin][row], drives.odometry[TICKS][row])
        at_begin = drives.poses[begin][row]
        own = relative(at_begin, estimator.at(TICKS * DT).pose)
        gained.append((distance(own, truth), distance(believed, truth)))
    own, believed = np.array(gained).T
    assert rms(own) < 0.6 * rms(believed)


def test_late_poses_out_of_order_count_as_prompt_ones(drives):
    delays = [0, 7, 3, 9, 1, 5, 2, 8]
    for row in range(3):
        _, _, prompt = follow(drives, row, every=2)
        errors, _, late = follow(
            drives, row, every=2, late=lambda tick: delays[tick // 2 % 8] % (TICKS + 1 - tick)
        )
        assert late.poses[Outcome.TOO_OLD] == 0
        assert late.poses[Outcome.ACCEPTED] == prompt.poses[Outcome.ACCEPTED] == TICKS // 2
        a, b = prompt.at(TICKS * DT), late.at(TICKS * DT)
        assert np.allclose([*a.pose, *a.velocity], [*b.pose, *b.velocity], rtol=0, atol=1e-9)
        assert np.allclose(a.covariance, b.covariance, rtol=0, atol=1e-12)
        assert np.hypot(*errors[:, :2].T).max() < 0.03


def straight(until_s):
    estimator = Estimator(SETTINGS)
    estimator.start(Pose(0, 0, 0), 0.0, covariance=COVARIANCE)
    for tick in range(1, round(until_s / DT) + 1):
        t = tick * DT
        v = min(0.1, 0.3 * t)
        estimator.odometry(Pose(_way(t), 0.0, 0.0), Velocity(v, 0.0), t)
    return estimator


def _way(t):
    """0.1 m/s, reached with 0.3 m/s²."""
    return 0.15 * t * t if t < 1 / 3 else 0.1 * t - 1 / 60


def test_a_pose_counts_for_the_moment_at_which_it_was_measured():
    sure = 1e-8 * np.eye(3)
    late = straight(3.0)
    assert late.external(Pose(_way(2.35) + 0.01, 0.02, 0.0), sure, 2.35) is Outcome.ACCEPTED
    assert late.at(3.0).pose == pytest.approx((_way(3.0) + 0.01, 0.02, 0.0), abs=0.003)
    assert straight(3.0).external(Pose(0, 0, 0), sure, 1.7) is Outcome.TOO_OLD
    assert straight(3.0).external(Pose(0, 0, 0), sure, -0.1) is Outcome.TOO_OLD

    early = straight(3.0)
    assert early.external(Pose(_way(3.05), 0.02, 0.0), sure, 3.05) is Outcome.WAITING
    assert early.at(3.1).pose.y == pytest.approx(0.0)
    early.odometry(Pose(_way(3.1), 0.0, 0.0), Velocity(0.1, 0.0), 3.1)
    assert early.at(3.1).pose.y == pytest.approx(0.02, abs=0.001)
    assert early.poses[Outcome.ACCEPTED] == 1


def test_many_late_poses_at_once_cost_hardly_more_than_one(monkeypatch):
    estimator, entered = straight(3.0), []
    once = CourseFilter._entered
    monkeypatch.setattr(CourseFilter, "_entered", lambda *args: (entered.append(1), once(*args))[1])
    times = np.linspace(2.05, 2.95, 80)
    for t in times:
        assert estimator.external(Pose(_way(t), 0.0, 0.0), COVARIANCE, t) is Outcome.ACCEPTED
    estimator.at(3.0)
    assert len(entered) < 3 * len(times)  # applied again each time it would be 80 times 50


def test_one_wrong_pose_is_rejected_and_many_are_a_fault_that_stays():
    estimator = straight(1.0)
    wrong, right = Pose(_way(1.0), 0.3, 0.0), Pose(_way(1.0), 0.0, 0.0)
    for _ in range(4):
        assert estimator.external(wrong, COVARIANCE, 1.0) is Outcome.OUTLIER
    assert estimator.external(right, COVARIANCE, 1.0) is Outcome.ACCEPTED
    assert not estimator.fault
    before = estimator.at(1.0)
    for _ in range(5):
        assert estimator.external(wrong, COVARIANCE, 1.0) is Outcome.OUTLIER
    assert estimator.fault_rule == "external-pose"
    assert estimator.fault == "5 external poses in a row refused, the last as outlier"
    assert estimator.at(1.0).pose == before.pose
    for _ in range(20):
        estimator.external(right, COVARIANCE, 1.0)
    assert estimator.fault_rule == "external-pose"


@pytest.mark.parametrize(
    ("pose", "covariance"),
    [
        (Pose(math.nan, 0, 0), COVARIANCE),
        (Pose(0, math.inf, 0), COVARIANCE),
        (Pose(0, 0, 0), np.full((3, 3), math.nan)),
        (Pose(0, 0, 0), -COVARIANCE),
        (Pose(0, 0, 0), np.array([[1e-4, 1e-3, 0], [1e-3, 1e-4, 0], [0, 0, 1e-4]])),
    ],
)
def test_invalid_poses_are_rejected(pose, covariance):
    estimator = straight(1.0)
    before = estimator.at(1.0)
    assert estimator.external(pose, covariance, 1.0) is Outcome.NOT_FINITE
    assert estimator.external(Pose(0, 0, 0), COVARIANCE, math.nan) is Outcome.NOT_FINITE
    after = estimator.at(1.0)
    assert after.pose == before.pose
    assert np.array_equal(after.covariance, before.covariance)


def test_a_variance_of_zero_counts_as_unknown():
    one, other = straight(1.0), straight(1.0)
    seen = Pose(_way(1.0) + 0.01, 0.01, 0.01)
    one.external(seen, np.zeros((3, 3)), 1.0)
    other.external(seen, np.diag([SETTINGS.pose_m**2, SETTINGS.pose_m**2, SETTINGS.pose_rad**2]), 1.0)
    assert one.at(1.0).pose == other.at(1.0).pose


def gyro_of(drives, seed, bias=0.02, noise=0.003):
    """Mean rates of turn of each step, then of a while at rest, with the bias and noise of a cheap gyro."""
    rng = np.random.default_rng(seed)
    turned = np.diff(np.unwrap(np.array(drives.poses)[:, :, 2], axis=0), axis=0) / DT
    rates = np.vstack([0 * turned[:1], turned, np.zeros((REST_TICKS, turned.shape[1]))])
    return rates + bias + noise * rng.normal(size=rates.shape)


def test_a_gyro_makes_the_heading_better_than_odometrys(drives):
    rates = gyro_of(drives, 5)
    with_gyro = [follow(drives, row, every=0, gyro=rates) for row in range(40)]
    without = [follow(drives, row, every=0) for row in range(40)]
    assert not any(run[2].fault for run in with_gyro)
    start = np.array(
        [wrap_angle(drives.seen(0, row).theta - drives.poses[0][row].theta) for row in range(40)]
    )
    gained = [rms([run[0][-1, 2] for run in runs] - start) for runs in (with_gyro, without)]
    assert gained[0] < 0.6 * gained[1]


def test_a_gap_of_the_gyro_adds_no_turn():
    estimator = Estimator(SETTINGS)
    estimator.start(Pose(0, 0, 0), 0.0)
    for tick in range(1, 60):
        t = tick * DT
        if not 20 <= tick < 30:
            # It stands; the time span of the gyro's first reading after the gap is unknown.
            estimator.gyro(0.5 if tick == 30 else 0.01, t)
        estimator.odometry(Pose(0, 0, 0), Velocity(0, 0), t)
    assert abs(estimator.at(6.0).pose.theta) < 0.002
