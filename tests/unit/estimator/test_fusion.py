"""Estimator on skid-steered rovers: external poses and a gyro beside odometry with all its errors."""

import functools
import math

import numpy as np
import pytest
from kit.base_odometry import DT, started, straight, way_m
from kit.skid_rover import Camera, SkidDrive
from scipy.stats import chi2

from deploy.drive.config import settings_for
from deploy.estimator.history import WAITING_MAX
from deploy.estimator.inputs import Acceptance
from deploy.estimator.settings import EstimatorSettings
from rover_ncp.core.geometry import Pose, Velocity, wrap_angle
from rover_ncp.robot.profile import RoverProfile

SETTINGS = EstimatorSettings()
COVARIANCE = np.diag(np.square([0.005, 0.005, math.radians(0.5)]))
ENDS = {
    "encoders": ({}, (0.00586, -0.02412, 0.08776)),
    "gyro": ({"gyro": True}, (-0.02456, -0.06411, 0.00258)),
    "camera": ({"camera": Camera()}, (0.00439, 0.00201, 0.00466)),
    "both": ({"camera": Camera(), "gyro": True}, (0.00206, 0.00511, 0.00065)),
}
"""Sensors, and the error at the end of the first drive of seed 1, m, m, rad."""


@functools.cache
def drives(count):
    return [SkidDrive(SETTINGS, 1, number) for number in range(count)]


@pytest.mark.parametrize("name", ENDS)
def test_drive_ends_where_it_did_and_within_its_ellipse(name):
    sensors, end = ENDS[name]
    errors, covariances, estimator = drives(1)[0].follow(**sensors)
    assert errors[-1] == pytest.approx(end, abs=1e-5)
    assert errors[-1] @ np.linalg.solve(covariances[-1], errors[-1]) < chi2.ppf(0.95, 3)
    assert not estimator.fault
    assert not estimator.rejected


def test_a_delay_that_all_poses_have_is_found():
    for delay_s in (0.0, 0.15):
        camera = Camera(delay_s=delay_s, sigma=(0.002, 0.002, 0.003))
        runs = [drive.follow(camera=camera)[0] for drive in drives(3)]
        assert max(math.hypot(*errors[-1, :2]) for errors in runs) < 0.004
        later = np.concatenate([errors[len(errors) // 2 :, :2] for errors in runs])
        assert np.sqrt(np.mean(np.square(later))) < 0.003  # not known, 0.15 s would be 15 mm


def test_measured_errors_of_odometry_enter_the_estimate():
    usual = SETTINGS.distance_gain_std
    std = {"odometry_heading": 0.01, "odometry_distance": usual, "rotation_center_m": 0.004}
    profile = RoverProfile(
        name="measured", odometry_heading=0.8, odometry_distance=1.0, rotation_center_m=-0.05, std=std
    )
    settings = settings_for(profile)
    assert settings.turn_gain == pytest.approx(1.25, abs=0.002)  # its share is 0.996 beside ±20 %
    assert settings.turn_gain_std == pytest.approx(0.01 / 0.8**2, rel=0.01)
    # As certain as that of an unmeasured robot: both together know it √2 better.
    assert settings.distance_gain_std == pytest.approx(usual / math.sqrt(2))

    estimator = started(settings)
    turned, rate = 0.0, 0.0
    for tick in range(1, 80):
        step = min(0.2, 0.1 * tick)
        turned, rate = turned + 0.5 * DT * (rate + step), step
        estimator.odometry(Pose(0, 0, turned), Velocity(0, rate), tick * DT)
    pose = estimator.at(79 * DT).pose
    true_turn = settings.turn_gain * turned
    center = settings.rotation_center_m
    assert pose.theta == pytest.approx(true_turn, abs=0.005)
    assert pose.x == pytest.approx(center * (math.cos(true_turn) - 1.0), abs=0.002)
    assert pose.y == pytest.approx(center * math.sin(true_turn), abs=0.002)


@pytest.mark.parametrize("asymmetry", [0.1, -0.1])
def test_the_slope_that_was_measured_enters_the_estimate(asymmetry):
    slope = {"downhill_x_m": 0.02, "downhill_y_m": -0.03, "std": {"downhill_x_m": 0.002}}
    settings = settings_for(RoverProfile(name="slope", turn_asymmetry=asymmetry, **slope))
    assert settings.downhill_std_m == 0.002
    unknown = RoverProfile(name="slope", turn_asymmetry=asymmetry, std=slope["std"])
    assert settings_for(unknown).downhill_std_m == SETTINGS.downhill_std_m
    ends = []
    for side in (1.0, -1.0):
        estimator = started(settings, heading=math.pi / 2)
        for tick in range(1, 80):
            rate = side * 0.2
            seen = Pose(0.0, 0.0, math.pi / 2 + rate * DT * (tick - 0.5))
            estimator.odometry(seen, Velocity(0.0, rate), tick * DT)
        ends.append(estimator.at(79 * DT).pose)
    turns = [math.remainder(end.theta - math.pi / 2, math.tau) for end in ends]
    assert turns[0] + turns[1] == pytest.approx(asymmetry * (turns[0] - turns[1]), abs=0.01)
    assert turns[0] > 1.3
    for end, turn in zip(ends, turns, strict=True):  # ahead at the start is y
        assert (end.x, end.y) == pytest.approx((0.03 * abs(turn), 0.02 * abs(turn)), abs=0.002)


@pytest.mark.parametrize("carried", [(0.0, -0.3, 0.0), (0.0, 0.0, 0.3)])
def test_a_rover_that_was_carried_or_turned_is_stopped_within_two_seconds(carried):
    (drive,) = drives(1)
    tick = round(0.6 * drive.ticks)
    _, _, estimator = drive.follow(camera=Camera(), carried=(tick, np.array(carried)))
    assert estimator.fault_rule == "external-pose"
    assert drive.stopped - tick <= 20


def test_a_rover_that_a_cable_turns_is_found_again():
    (drive,) = drives(1)
    carried = (round(0.5 * drive.ticks), np.array([0.02, 0.0, -0.11]))
    errors, _, estimator = drive.follow(camera=Camera(), carried=carried)
    assert not estimator.fault
    assert abs(wrap_angle(errors[-1][2] + 0.11)) < 0.05


@pytest.mark.parametrize(("off_rad", "may_be_a_push"), [(0.12, True), (0.3, False)])
def test_a_refused_pose_leaves_the_estimate_where_it_is(off_rad, may_be_a_push):
    estimator = straight(2.0)
    before, seen = estimator.at(2.0), Pose(way_m(2.0), 0.0, off_rad)
    assert estimator.external(seen, COVARIANCE, 2.0) is Acceptance.OUTLIER
    after = estimator.at(2.0)
    assert after.pose == pytest.approx(before.pose, abs=1e-12)
    grown = np.diag(after.covariance - before.covariance)[:3]
    push = np.square([SETTINGS.disturbance_m, SETTINGS.disturbance_m, SETTINGS.disturbance_rad])
    assert grown == pytest.approx(may_be_a_push * push, rel=1e-3, abs=1e-12)
    again = estimator.external(seen, COVARIANCE, 2.0)
    assert again is (Acceptance.ACCEPTED if may_be_a_push else Acceptance.OUTLIER)


def test_a_pose_counts_for_the_moment_at_which_it_was_measured():
    sure, prompt = 1e-8 * np.eye(3), EstimatorSettings(pose_delay_s=0.0, pose_delay_std_s=1e-6)
    late = straight(3.0, prompt)
    assert late.external(Pose(way_m(2.35) + 0.01, 0.02, 0.0), sure, 2.35) is Acceptance.ACCEPTED
    assert late.at(3.0).pose == pytest.approx((way_m(3.0) + 0.01, 0.02, 0.0), abs=0.003)
    assert straight(3.0).external(Pose(0, 0, 0), sure, 1.7) is Acceptance.TOO_OLD
    assert straight(3.0).external(Pose(0, 0, 0), sure, -0.1) is Acceptance.TOO_OLD

    early = straight(3.0, prompt)
    assert early.external(Pose(way_m(3.05), 0.02, 0.0), sure, 3.05) is Acceptance.WAITING
    assert early.at(3.1).pose.y == pytest.approx(0.0)
    early.odometry(Pose(way_m(3.1), 0.0, 0.0), Velocity(0.1, 0.0), 3.1)
    assert early.at(3.1).pose.y == pytest.approx(0.02, abs=0.001)
    assert early.poses[Acceptance.ACCEPTED] == 1


def test_a_pose_beyond_half_a_turn_is_near():
    estimator = started(heading=math.pi - 0.001, covariance=COVARIANCE)
    estimator.odometry(Pose(0.0, 0.0, math.pi - 0.001), Velocity(0.0, 0.0), DT)
    assert estimator.external(Pose(0.0, 0.0, 0.001 - math.pi), COVARIANCE, DT) is Acceptance.ACCEPTED


def test_poses_beyond_those_that_may_wait_for_odometry_are_dropped():
    estimator = straight(1.0)
    found = [estimator.external(Pose(0, 0, 0), COVARIANCE, 1.5) for _ in range(WAITING_MAX + 1)]
    assert found == [*[Acceptance.WAITING] * WAITING_MAX, Acceptance.DROPPED]
    assert not estimator.fault


def test_one_wrong_pose_is_rejected_and_many_are_a_fault_that_stays():
    estimator = straight(1.0)
    wrong, right = Pose(way_m(1.0), 0.3, 0.0), Pose(way_m(1.0), 0.0, 0.0)
    for _ in range(4):
        assert estimator.external(wrong, COVARIANCE, 1.0) is Acceptance.OUTLIER
    assert estimator.external(right, COVARIANCE, 1.0) is Acceptance.ACCEPTED
    assert not estimator.fault
    before = estimator.at(1.0)
    for _ in range(5):
        assert estimator.external(wrong, COVARIANCE, 1.0) is Acceptance.OUTLIER
    assert estimator.fault_rule == "external-pose"
    assert estimator.fault == "5 external poses rejected in a row (last: outlier)"
    assert estimator.at(1.0).pose == pytest.approx(before.pose, abs=1e-12)
    for _ in range(20):
        estimator.external(right, COVARIANCE, 1.0)
    assert estimator.fault_rule == "external-pose"


@pytest.mark.parametrize(
    ("pose", "covariance"),
    [
        (Pose(math.nan, 0, 0), COVARIANCE),
        (Pose(0, 0, 0), np.full((3, 3), math.nan)),
        (Pose(0, 0, 0), np.array([[1e-4, 1e-3, 0], [1e-3, 1e-4, 0], [0, 0, 1e-4]])),
    ],
)
def test_invalid_poses_are_rejected(pose, covariance):
    estimator = straight(1.0)
    before = estimator.at(1.0)
    assert estimator.external(pose, covariance, 1.0) is Acceptance.NOT_FINITE
    assert estimator.external(Pose(0, 0, 0), COVARIANCE, math.nan) is Acceptance.NOT_FINITE
    after = estimator.at(1.0)
    assert after.pose == pytest.approx(before.pose, abs=1e-12)
    assert np.array_equal(after.covariance, before.covariance)


def test_a_gap_of_the_gyro_adds_no_turn():
    estimator = started()
    for tick in range(1, 60):
        t = tick * DT
        if not 20 <= tick < 30:
            # It stands; the time span of the gyro's first reading after the gap is unknown.
            estimator.gyro(0.5 if tick == 30 else 0.01, t)
        estimator.odometry(Pose(0, 0, 0), Velocity(0, 0), t)
    assert abs(estimator.at(6.0).pose.theta) < 0.002
