"""A gyro's messages between two odometry messages of a ROS 2 robot."""

import math
import random

import pytest
from kit.ros2_world import World, header

from rover_ncp.wire.cdr import encode
from rover_ncp.wire.messages import IMU


@pytest.fixture
def world():
    world = World()
    world.run(1.5)
    world.turns.clear()
    return world


def imu(rate, stamp_s=None):
    stamp = {} if stamp_s is None else {"header": header(stamp_s, "imu_link")}
    return encode(IMU, **stamp, angular_velocity={"z": rate})


def turned(world, messages):
    """Return the angle that a driver integrates, and that of the gyro until then.

    ``messages`` are (arrival, None) of odometry and (arrival, (stamp, rate)) of the gyro, times in seconds;
    each rate is the mean since the message before.
    """
    begin, true, stamp_before_s, angle, last_s, true_then = world.now, 0.0, 0.0, 0.0, None, 0.0
    for arrival_s, reading in sorted(messages, key=lambda each: each[0]):
        world.now = begin + arrival_s
        if reading is None:
            world.odom()
        else:
            stamp_s, rate = reading
            true += rate * (stamp_s - stamp_before_s)
            stamp_before_s = stamp_s
            world.hear("imu", imu(rate, world.clock_s + begin + stamp_s))
        for turn in world.turns:
            at_s = world.now - turn.age_s
            angle = true if last_s is None else angle + turn.rate * (at_s - last_s)
            last_s, true_then = at_s, true
        world.turns.clear()
    return angle, true_then


@pytest.mark.parametrize("rate_hz", [20, 25, 100])
def test_a_gyro_beside_odometry_of_20_hz_shows_its_whole_turn(rate_hz, world):
    """Both are sent at the same moments and overtake each other; the robot turns in jerks."""
    random_ = random.Random(rate_hz)
    odometry = [(0.05 * k + random_.uniform(0.0, 0.004), None) for k in range(200)]
    stamps = [k / rate_hz for k in range(10 * rate_hz)]
    gyro = [(at + random_.uniform(0.0, 0.004), (at, random_.uniform(-0.5, 0.5))) for at in stamps]
    angle, true = turned(world, odometry + gyro)
    assert angle == pytest.approx(true, abs=0.005)


def test_a_gyro_without_a_clock_counts_by_arrivals(world):
    for rate in (0.2, 0.4, math.nan):
        world.run(0.02, odom=False)
        world.hear("imu", imu(rate))
    world.run(0.06)
    assert [turn.rate for turn in world.turns] == [pytest.approx(0.4)]
    assert world.turns[0].age_s == pytest.approx(0.03, abs=0.021)


def test_the_time_after_a_pause_of_the_gyro_is_not_known(world):
    world.run(0.1, each=lambda: world.hear("imu", imu(0.5, world.clock_s + world.now)))
    world.run(0.1)
    world.turns.clear()
    world.run(1.0)
    assert not world.turns
    world.hear("imu", imu(-0.5, world.clock_s + world.now))
    world.run(0.06)
    assert [turn.rate for turn in world.turns] == [pytest.approx(-0.5)]


def test_a_message_that_comes_twice_counts_once(world):
    for rate in (0.1, 0.3, 0.1):
        world.now += 0.01
        for _ in range(2 if rate == 0.3 else 1):
            world.hear("imu", imu(rate, world.clock_s + world.now))
    world.run(0.06)
    assert [turn.rate for turn in world.turns] == [pytest.approx(0.2)]
    assert world.base.health().counters["imu left out"] == 1
