"""A ROS 2 robot's laser, by which there is room around it, and its gyro between two odometry messages."""

import math
import re
import struct

import numpy as np
import pytest
from kit.ros2_world import BURGER, EPOCH_S, World, header

from bridge.base import Notice, PassedOn
from bridge.ros2.gyro import GyroTurns
from rover_ncp.robot.description import load_description
from rover_ncp.wire.cdr import encode
from rover_ncp.wire.messages import (
    BATTERY_STATE,
    IMU,
    LASER_SCAN,
    POSE_STAMPED,
)

SIGNALLING_NAN = bytes.fromhex("0100807f")
"""As a float32. numpy warns when it casts one."""


def scan(*hits, first_deg=0.0, count=360, step_deg=1.0, else_m=math.inf, min_m=0.1, max_m=8.0, stamp_s=0.0):
    """Return a LaserScan's bytes; ``hits`` are (degrees from the laser's x-axis, range in m)."""
    ranges = [else_m] * count
    for degrees, range_m in hits:
        ranges[round((degrees - first_deg) / step_deg) % 360] = range_m
    return encode(
        LASER_SCAN,
        header=header(stamp_s, "base_scan"),
        angle_min=math.radians(first_deg),
        angle_max=math.radians(first_deg + step_deg * (count - 1)),
        angle_increment=math.radians(step_deg),
        range_min=min_m,
        range_max=max_m,
        ranges=np.array(ranges, np.float32),
    )


def room(world, payload, **odometry):
    """The room ahead and behind, m, by a scan."""
    world.hear("scan", payload)
    world.run(0.1, **odometry)
    return world.reports[-1].clear_ahead_m, world.reports[-1].clear_behind_m


def test_a_scan_that_no_laser_can_measure_shows_no_room(ready):
    """By a step of 100 rad, each direction was scanned; by one of 1e-30 rad, the direction ahead."""
    assert room(ready, scan(step_deg=-1.0)) == (math.inf, math.inf)
    for impossible in (
        scan(step_deg=math.degrees(100.0)),
        scan(step_deg=1e-30),
        scan(count=800),
    ):
        ready.run(2.0)
        assert np.isnan(room(ready, impossible)).all()


@pytest.mark.parametrize(
    ("payload", "ahead", "behind"),
    [
        # The Burger's laser is 0.032 m behind its centre; its outline ends 0.041 m before it, 0.105 m behind.
        (scan((0, 1.0)), 1.0 - 0.032 - 0.041, math.inf),
        (scan((0, 1.0), (180, 0.5)), 0.927, 0.427),
        (scan((90, 0.3), (45, 0.5)), math.inf, math.inf),  # beside the way
        (scan((8, 1.0)), math.cos(math.radians(8)) - 0.073, math.inf),  # 0.139 m from the middle line
        (scan((0, 0.05)), math.inf, math.inf),  # below the least range
        (scan((0, 1.25)).replace(struct.pack("<f", 1.25), SIGNALLING_NAN), math.inf, math.inf),
        (scan((0, -math.inf)), 0.1 - 0.032 - 0.041, math.inf),  # REP 117: nearer than the least range, 0.1 m
        (scan((0, 2.0), first_deg=-90.0, count=181), 2.0 - 0.073, math.nan),  # it looks ahead only
        # A laser that is covered, blinded or broken: beams to the sides do not show the way.
        *(
            (scan((90, 1.0), (270, math.inf), else_m=nothing_m), math.nan, math.nan)
            for nothing_m in (math.nan, 0.0, 9.0)
        ),
        # A cover within the outline hides the way.
        (scan(*((degrees, 0.068) for degrees in range(-60, 61)), min_m=0.05), math.nan, math.inf),
        # A post of the robot's own, 0.038 m before its centre, and a thing outside, 0.134 m behind it.
        (scan((0, 0.07), (180, 0.102)), math.inf, 0.029),
    ],
)
def test_room_by_a_scan_counts_from_the_outline(ready, payload, ahead, behind):
    assert room(ready, payload) == pytest.approx((ahead, behind), abs=1e-3, nan_ok=True)


def test_a_laser_that_looks_to_the_left_is_turned():
    world, frames = World(load_description("turtlebot4")), ("odom", "base_link")
    world.run(2.0, frames=frames)
    ahead, _ = room(world, scan((-90, 1.0)), frames=frames)
    assert ahead == pytest.approx(1.0 - 0.04 - 0.171, abs=1e-3)


# The gyro


def imu(rate, stamp_s=None):
    stamp = {} if stamp_s is None else {"header": header(stamp_s, "imu_link")}
    return encode(IMU, **stamp, angular_velocity={"z": rate})


def pose_of(degrees=0.0, axis="z", frame="map"):
    """Return a PoseStamped at x = 1, turned about an axis."""
    half = math.radians(degrees) / 2
    place = {"position": {"x": 1.0}, "orientation": {axis: math.sin(half), "w": math.cos(half)}}
    return encode(POSE_STAMPED, header=header(EPOCH_S, frame), pose=place)


@pytest.fixture
def localising():
    """A robot with a localiser of its own, whose base is ready."""
    topics = BURGER.topics.model_copy(update={"pose": "amcl_pose"})
    return World(BURGER.model_copy(update={"topics": topics})).run(1.0)


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (pose_of(90.0, axis="x"), "lies on its side: its z axis is 90° from vertical, expected z up"),
        (pose_of(frame="m" * 100_000), "not geometry_msgs|bytes, expected 4096"),
        (encode(POSE_STAMPED), "is not a rotation"),
    ],
    ids=["y up", "long frame", "no rotation"],
)
def test_pose_that_is_none_is_not_passed_on_and_is_named_once(localising, payload, words):
    localising.run(1.5, each=lambda: localising.hear("amcl_pose", payload))
    assert not any(isinstance(event, PassedOn) for event in localising.events)
    notices = [event.text for event in localising.events if isinstance(event, Notice)]
    assert [bool(re.search(words, each)) for each in notices] == [True]


# Messages that cannot be used


BAD = {
    "imu": (imu(math.nan), "its rate of turn is nan"),
    "battery_state": (encode(BATTERY_STATE, voltage=math.nan), "its voltage is nan"),
    "scan": (scan(max_m=math.nan), "range_min is 0.1 and range_max nan, expected range_min < range_max"),
}


@pytest.mark.parametrize("topic", BAD)
def test_a_topic_that_sends_nothing_to_be_used_is_named_once_with_reason_and_count(ready, topic):
    payload, reason = BAD[topic]
    ready.run(5.0, each=lambda: ready.hear(topic, payload))
    notices = [event.text for event in ready.events if isinstance(event, Notice)]
    assert len(notices) == 1
    assert re.fullmatch(rf"\d+ messages on {topic} cannot be used: {reason}", notices[0])
    assert any(f"on {topic} cannot be used: {reason}" in words for words in ready.base.health().unheard)


def test_readings_of_a_gyro_count_for_the_time_between_them_but_not_for_that_of_a_pause():
    turns = GyroTurns()

    def mean(*readings):
        for at_s, rate in readings:
            turns.take(imu(rate, EPOCH_S + at_s), at_s)
        return turns.since_last(at_s + 0.01)

    found = mean((1.0, 9.0), (1.04, 1.0), (1.1, 3.0))
    assert (found.rate, found.age_s) == pytest.approx((2.2, 0.01), abs=1e-6)
    assert mean((1.12, 0.5), (3.0, -0.5)).rate == pytest.approx(-0.5, abs=1e-6)
    assert mean((3.04, 0.7)).rate == pytest.approx(0.7, abs=1e-6)
