"""Odometry of a ROS 2 robot: its rate, its clocks, two publishers, restarts."""

from itertools import pairwise

import pytest
from kit.ros2_world import EPOCH_S, odometry

from bridge.base import Lost, Notice, Ready, Recovered


def test_jitter_does_not_lose_it(ready):
    for late_s in [0.0, 0.06, 0.01, 0.08, 0.03] * 20:
        stamp_s = EPOCH_S + ready.now
        ready.run(late_s, odom=False)
        ready.hear("odom", odometry(stamp_s))
        ready.run(0.05, odom=False)
    assert [type(event) for event in ready.events] == [Ready]


def test_bursts_of_old_odometry_do_not_count(ready):
    for _ in range(6):
        first_s = EPOCH_S + ready.now
        ready.run(1.0, odom=False)
        for k in range(20):
            ready.hear("odom", odometry(first_s + 0.05 * k))
    assert [type(event) for event in ready.events] == [Ready, Lost]  # it does not recover between bursts


@pytest.mark.parametrize(("ahead_s", "pose"), [(0.001, {"x": 3.0, "y": 2.0}), (-100.0, {})])
def test_two_publishers_of_odometry_stop_it(ready, ahead_s, pose):
    """Two robots on one topic, apart in place or by their clocks, without any sign of who sent what."""

    def other():
        ready.hear("odom", odometry(EPOCH_S + ready.now + ahead_s, **pose))

    ready.run(1.0, rate_hz=100.0, each=other)
    assert ready.last == Lost("two publishers on odom")
    ready.run(5.0)
    assert isinstance(ready.last, Recovered)


# Clocks that are set, stamps that are bad, robots that restart.


def gaps_s(world, seconds):
    """Return the longest time without a report."""
    reported_s, before = [world.now], len(world.reports)
    for _ in range(round(seconds * 100)):
        world.run(0.01, odom=False)
        if round(world.now * 100) % 5 == 0:
            world.odom()
        if len(world.reports) > before:
            before = len(world.reports)
            reported_s.append(world.now)
    return max(after - before for before, after in pairwise([*reported_s, world.now]))


@pytest.mark.parametrize("back_s", [0.2, 1.0])
def test_a_clock_that_is_set_back_a_little_costs_one_message_and_is_named(ready, back_s):
    ready.setpoint_v = 0.2
    ready.run(2.0)
    ready.setpoint_v = 0.0
    ready.clock_s -= back_s
    assert gaps_s(ready, 3.0) < 0.12
    assert ready.events[1:] == [Notice(f"the clock that stamps odom was set back by {back_s:.2f} s")]
    assert ready.reports[-1].x == pytest.approx(0.4)
    assert ready.stamp_s == pytest.approx(ready.clock_s + ready.now, abs=0.06)


@pytest.fixture
def driven(ready):
    """A robot that has driven 0.6 m and is sent zeros."""
    ready.setpoint_v = 0.2
    ready.run(3.0)
    ready.setpoint_v = 0.0
    return ready


@pytest.mark.parametrize(
    ("new", "silent_s"), [({"x": 0.0}, 0.8), ({"x": 0.6, "y": 0.3}, 60.0), ({"x": 0.6, "theta": 0.5}, 3.5)]
)
def test_a_robot_that_restarts_elsewhere_is_not_taken_for_the_old_one(driven, new, silent_s):
    """It was sent zeros while it was silent, so it cannot have driven there."""
    driven.run(silent_s, odom=False)
    driven.run(2.0, **new)
    assert isinstance(driven.last, Ready)
    assert (driven.reports[-1].x, driven.reports[-1].y, driven.reports[-1].theta) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("coasted_m", [0.0, 0.1])
def test_a_robot_that_coasts_while_it_is_silent_keeps_its_odometry(driven, coasted_m):
    driven.run(3.5, odom=False)
    assert driven.last == Lost("no odometry on odom for 0.5 s")
    driven.x += coasted_m
    driven.run(2.0)
    assert isinstance(driven.last, Recovered)
    assert driven.reports[-1].x == pytest.approx(0.6 + coasted_m)


@pytest.mark.parametrize("jump", [{"x": 0.9}, {"theta": 2.0}])
def test_one_pose_elsewhere_costs_a_sample_and_two_begin_odometry_anew(driven, jump):
    before = len(driven.reports)
    driven.run(0.04, **jump)
    driven.run(2.0)
    assert [type(event) for event in driven.events] == [Ready]
    assert {(round(report.x, 6), report.y) for report in driven.reports[before:]} == {(0.6, 0.0)}
    driven.run(3.0, **jump)
    assert [type(event) for event in driven.events] == [Ready, Lost, Ready]
    assert "its pose jumped" in driven.events[1].reason
    assert driven.reports[-1].x == 0.0
