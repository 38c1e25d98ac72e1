"""Errors of odometry from stands whose truth is known, with both signs of each."""

from dataclasses import replace

import numpy as np
import pytest
from kit.base_odometry import MOTION_CAPTURE, moved

from deploy.identify.fit import identify
from deploy.identify.motion_log import motion_log
from rover_ncp.core.geometry import ORIGIN, Pose, Velocity
from rover_ncp.recording.recording import Recorded
from rover_ncp.robot.description import load_description
from rover_ncp.robot.lasting_error import LastingError
from rover_ncp.wire.messages import (
    COURSE_FRAME,
    odometry,
    pose_with_covariance,
    read_odometry,
    read_pose,
    twist_stamped,
)

STRAIGHT = [(0.25, 0.0), (-0.25, 0.0), (0.2, 0.0), (-0.3, 0.0)]
HALF_CIRCLE = [(0.2, 0.785), (-0.2, -0.785)]


def messages_of(ways, *, scale=1.0, turn_scale=1.0, skew_s=lambda t: 0.0, seconds=4.0, lasting=None, seed=11):
    """Messages of a drive over some ways, each a list of (v, omega) of the true motion, with stands between.

    ``skew_s`` is by how much the clock of the driver, which receives the messages, is ahead of the bridge's.
    ``lasting`` is the lasting error of the poses.
    """
    random, found = np.random.default_rng(seed), []
    known = LastingError(position_m=0.0, heading_rad=0.0, time_s=1.0) if lasting is None else lasting
    position_m, heading_rad, last_s = known.values
    size = np.array([position_m, position_m, heading_rad])
    error = size * random.normal(size=3)
    own, true, t, period = ORIGIN, ORIGIN, 0.0, 0.05

    def add(topic, data):
        log_ns = round((t + skew_s(t) + random.uniform(0.001, 0.01)) * 1e9)
        found.append(Recorded(topic, "", data, log_ns, log_ns))

    for way in ways:
        for v, omega in (*way, (0.0, 0.0)):
            for _ in range(round((seconds / len(way) if v or omega else 1.5) / period)):
                t += period
                own = moved(own, turn_scale * omega * period, scale * v * period)
                true = moved(true, omega * period, v * period)
                stamp_ns = round(t * 1e9)
                add("rover/cmd_out", twist_stamped(Velocity(v, omega), stamp_ns))
                add("odom", odometry(own, Velocity(scale * v, turn_scale * omega), stamp_ns))
                kept = np.exp(-period / last_s)
                error = kept * error + np.sqrt(1.0 - kept**2) * size * random.normal(size=3)
                seen = np.array(true) + error + random.normal(size=3) * [0.001, 0.001, 0.002]
                add("pose", pose_with_covariance(Pose(*seen), np.eye(3), stamp_ns, COURSE_FRAME))
    return found


@pytest.fixture
def distance_only(monkeypatch):
    """Leave out the other fits, which take the most time."""
    for fit in ("identify_axis", "fit_turns", "fit_center"):
        monkeypatch.setattr(f"deploy.identify.fit.{fit}", lambda *_: None)


@pytest.mark.usefixtures("distance_only")
@pytest.mark.parametrize(
    "skew_s",
    [lambda t: 3600.0, lambda t: -0.01 * t, lambda t: 0.5 if t > 20.0 else 0.0],
)
def test_clocks_of_driver_and_bridge_may_differ(skew_s):
    messages = messages_of([[way] for way in 3 * STRAIGHT], scale=1.05, skew_s=skew_s)
    log = motion_log(messages, None, lambda frame: MOTION_CAPTURE)
    late = log.external.t - log.odometry.t
    assert abs(late).max() < 0.05 or skew_s(21.0) - skew_s(19.0) > 0.4
    found = identify(log, "skewed")
    assert found.odometry_distance == pytest.approx(1.05, abs=0.004)
    assert abs(found.odometry_distance - 1.05) < 4.0 * found.std["odometry_distance"]


def test_intervals_contain_the_errors_of_poses_that_last(monkeypatch):
    monkeypatch.setattr("deploy.identify.fit.identify_axis", lambda *_: None)
    declared = LastingError(position_m=0.02, heading_rad=0.02, time_s=10.0)
    ways = [[way] for way in [*STRAIGHT, *HALF_CIRCLE, (0.0, 0.5), (0.0, -0.5)] * 2]
    inside = {True: [], False: []}
    for seed in range(10):
        messages = messages_of(ways, lasting=declared, seed=seed)
        for told, shares in inside.items():
            error = declared if told else MOTION_CAPTURE
            found = identify(motion_log(messages, None, lambda frame, error=error: error), "lasting")
            for name, true in (("odometry_distance", 1.0), ("rotation_center_m", 0.0)):
                if (value := getattr(found, name)) is not None:
                    shares.append(abs(value - true) <= 1.96 * found.std[name])
    assert min(map(len, inside.values())) >= 15
    assert np.mean(inside[True]) >= 0.9
    assert np.mean(inside[False]) < 0.8


@pytest.mark.parametrize(
    "seen",
    [
        lambda number, pose: pose if number < 20 else None,
        lambda number, pose: Pose(3.0, 1.0, 0.5),
        lambda number, pose: Pose(0.2 * pose.x, 0.2 * pose.y, 0.2 * pose.theta),
    ],
    ids=["end early", "stand still", "of another object"],
)
def test_external_poses_that_do_not_show_the_drive_give_no_errors_of_odometry(seen):
    messages, number = [], 0
    for message in messages_of([[way] for way in [*STRAIGHT, *HALF_CIRCLE, (0.0, 0.5), (0.0, -0.5)] * 2]):
        if message.topic == "pose":
            sample, number = read_pose(message.data), number + 1
            if (pose := seen(number, sample.pose)) is None:
                continue
            data = pose_with_covariance(pose, sample.covariance, sample.stamp_ns, sample.frame)
            message = replace(message, data=data)  # noqa: PLW2901
        messages.append(message)
    found = identify(motion_log(messages, None, lambda frame: MOTION_CAPTURE), "astray")
    assert (found.odometry_distance, found.odometry_heading, found.slip_s) == (None, None, None)
    assert (found.rotation_center_m, found.wheel_mismatch_rad_m, found.turn_asymmetry) == (None, None, None)


def test_motion_of_a_robot_that_reports_mean_speeds_is_that_of_its_poses():
    messages, last, reported = messages_of([[way] for way in STRAIGHT] + [HALF_CIRCLE]), [], []
    for message in messages:
        if message.topic == "odom":
            sample = read_odometry(message.data)
            last = [*last[-19:], sample.velocity]  # of a second
            mean = Velocity(*np.mean(last, axis=0).tolist())
            message = replace(message, data=odometry(sample.pose, mean, sample.stamp_ns))  # noqa: PLW2901
        reported.append(message)
    true = motion_log(messages).motion
    found = motion_log(reported, load_description("husky-a200")).motion
    assert (np.mean(np.abs(found - true), axis=0) < [0.008, 0.015]).all()
    assert (np.mean(np.abs(motion_log(reported).motion - true), axis=0) > [0.02, 0.04]).all()
