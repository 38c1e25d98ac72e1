"""What a check makes of a gyro and of external poses, beside odometry's motion."""

import math
import random

import pytest

from deploy.comparisons import (
    SKID_TURN_SHARES,
    TURN_SHARES,
    Samples,
    gyro_at_rest,
    gyro_in_turn,
    poses_at_rest,
    poses_in_turn,
    poses_on_way,
    room_on_way,
)
from rover_ncp.core.geometry import Pose, compose

V, OMEGA = 0.1, 0.25
MAP = Pose(2.0, -1.0, 2.8)
"""Where odometry begins, in the frame of the poses."""


def motion(at_s, rate):
    """Return the way at a time: from 0.5 s on at a rate, for 1.5 s."""
    return rate * min(max(at_s - 0.5, 0.0), 1.5)


def samples(
    v=0.0, omega=0.0, *, scale=1.0, gyro=None, lag_s=0.0, hz=20, noise=0.003, change=lambda pose: pose
):
    """Return the samples of a step of 3 s; ``scale`` is that of poses, ``gyro`` of the gyro."""
    draw, found = random.Random(1), Samples()
    for k in range(60):
        at_s = k / 20
        found.odometry.append((at_s, Pose(motion(at_s, v), 0.0, motion(at_s, omega))))
        if gyro is not None:
            mean = (motion(at_s - lag_s, omega) - motion(at_s - lag_s - 0.05, omega)) / 0.05
            found.gyro.append((at_s, gyro * mean + 0.02 + draw.gauss(0.0, 0.005)))
    for k in range(round(3 * hz)):
        at_s = k / hz
        true = Pose(scale * motion(at_s - lag_s, v), 0.0, motion(at_s - lag_s, omega))
        x, y, theta = change(compose(MAP, true))
        x, y, theta = (value + draw.gauss(0.0, noise) for value in (x, y, theta))
        found.poses.append((at_s, Pose(x, y, theta)))
    return found


REST = samples(gyro=1.0)


@pytest.mark.parametrize(
    ("gyro", "lag_s", "ok", "words"),
    [
        (1.0, 0.0, True, "where odometry turned 0.375 rad (right: 0.6 to 1.6"),
        (-1.0, 0.0, False, "sign is wrong"),
        (0.5, 0.0, False, "its scale or its axis is wrong"),
        (1.0, 0.6, False, "0.60 s late"),
    ],
)
def test_gyro_is_compared_with_odometry(gyro, lag_s, ok, words):
    turn = samples(omega=OMEGA, gyro=gyro, lag_s=lag_s)
    found, detail = gyro_in_turn(REST, turn, SKID_TURN_SHARES, on_floor=True)
    assert found is ok, detail
    assert words in detail


def test_gyro_that_is_silent_or_biased_or_has_gaps_is_not_right():
    assert gyro_at_rest(REST)[0]
    assert not gyro_at_rest(Samples(odometry=REST.odometry))[0]
    rest, turn = (samples(omega=omega, gyro=1.0) for omega in (0.0, OMEGA))
    for each in (rest, turn):
        each.gyro = [(at_s, rate + 1.0) for at_s, rate in each.gyro]
    ok, words = gyro_in_turn(rest, turn, TURN_SHARES, on_floor=False)
    assert not ok
    assert "+1.02 rad/s at rest (at most 0.4)" in words
    assert not gyro_at_rest(Samples(REST.odometry, REST.gyro[::10]))[0]
    assert not gyro_in_turn(
        REST, Samples(odometry=samples(omega=OMEGA).odometry), TURN_SHARES, on_floor=True
    )[0]


def mirrored(pose):
    return Pose(pose.y, pose.x, math.pi / 2 - pose.theta)


@pytest.mark.parametrize(
    ("options", "ok", "words"),
    [
        ({}, True, "moved 0.15"),
        ({"hz": 4, "noise": 0.01}, True, "moved 0.1"),
        ({"scale": 0.5}, False, "is the size of tags or map wrong?"),
        ({"change": lambda pose: MAP}, False, "repeats itself"),
        ({"hz": 1}, True, "not known: 3 poses"),
    ],
)
def test_poses_are_compared_with_odometry_on_a_straight_way(options, ok, words):
    found, detail = poses_on_way(samples(V, **options), on_floor=True)
    assert found is ok, detail
    assert words in detail


@pytest.mark.parametrize(
    ("options", "ok", "words"),
    [
        ({}, True, "turned 0.3"),
        ({"change": mirrored}, False, "mirrored"),
    ],
)
def test_headings_of_poses_are_compared_with_odometry_on_a_turn(options, ok, words):
    found, detail = poses_in_turn(samples(omega=OMEGA, **options), TURN_SHARES, on_floor=True)
    assert found is ok, detail
    assert words in detail


def test_poses_that_are_rare_or_in_two_frames_are_not_right():
    assert poses_at_rest(REST, ["course"] * 60, 0.1)[0]
    assert not poses_at_rest(samples(hz=0.5), ["course"], 0.1)[0]
    assert not poses_at_rest(samples(noise=0.2), ["course"], 0.1)[0]
    found, words = poses_at_rest(REST, ["map", "course"] * 30, 0.1)
    assert not found
    assert "course, map" in words


@pytest.mark.parametrize(
    ("before", "after", "on_floor", "ok"),
    [
        ((2.0, 1.0), (1.85, 1.15), True, True),
        ((None, 1.0), (3.0, None), True, True),  # nothing to compare
        ((2.0, 1.0), (2.15, 0.85), False, False),  # turned by half a turn
        ((2.0, 1.0), (2.0, 1.0), False, True),
    ],
)
def test_room_of_a_laser_shrinks_ahead_and_grows_behind(before, after, on_floor, ok):
    assert room_on_way(before, after, 0.15, on_floor=on_floor)[0] is ok
