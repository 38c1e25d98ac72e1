"""A ROS 2 robot's stop button and hazards: what stops it, and what their silence does."""

import pytest
from kit.described import described
from kit.ros2_world import World

from bridge.base import Ready
from bridge.ros2.discovery import Announced, TokenSeen
from rover_ncp.wire.cdr import encode
from rover_ncp.wire.messages import BOOL, hazards

UINT8 = "std_msgs/msg/UInt8"
LATCHED = {"topic": "stop", "latched": True}


def world_of(**topics):
    """Return a ready robot with these topics for hazards."""
    world = World(described("turtlebot3-burger", topics=topics)).run(2.0)
    assert isinstance(world.last, Ready)
    return world


def press(world, pressed):
    world.hear("stop", encode(BOOL, data=pressed))


def unknown(world, seconds=0.1):
    """Let time pass; return why it is not known whether there is a hazard."""
    world.run(seconds)
    return world.reports[-1].hazard_unknown


def publisher(there, zid="estop", ros_type=BOOL, source=None):
    return TokenSeen(Announced(zid, True, "stop", ros_type, "/estop", source), there)


def test_a_stop_and_a_contact_that_end_before_the_next_odometry_are_passed_on_once():
    world = world_of(stop="stop", hazards="hazard_detection")
    for pressed, kinds in ((True, (1,)), (False, (3,)), (False, ())):
        press(world, pressed)
        world.hear("hazard_detection", hazards(kinds, 0))
    before = len(world.reports)
    world.run(0.5)
    found = [(report.bumpers, report.stalled) for report in world.reports[before:]]
    assert found[0] == ((1, 0), (True, True))
    assert set(found[1:]) == {((0, 0), (False, False))}
    assert world.reports[before].stop_pressed


@pytest.mark.parametrize(("stop", "silence_s"), [("stop", 3.0), ({"topic": "stop", "periodic_s": 0.2}, 0.6)])
def test_silence_of_three_periods_counts_as_a_hazard(stop, silence_s):
    world = world_of(stop=stop)
    press(world, False)
    assert unknown(world, silence_s - 0.1) == ""
    assert unknown(world, 0.3) == f"stop: no new message for {silence_s:g} s, which is three periods"
    press(world, False)
    assert unknown(world) == ""


def test_a_latched_stop_counts_while_its_publisher_is_announced():
    world = world_of(stop=LATCHED)
    press(world, False)
    assert "no publisher is announced" in unknown(world)
    world.tell(publisher(True, zid="ours"))  # a token of the bridge itself
    assert "no publisher is announced" in unknown(world)
    world.tell(publisher(True))
    assert unknown(world, 60.0) == ""
    world.tell(publisher(False))
    assert "no publisher is announced" in unknown(world)
    world.tell(publisher(True))  # it began again, and may be pressed now
    assert "no message has come" in unknown(world)
    press(world, False)
    assert unknown(world) == ""


@pytest.mark.parametrize("stop", ["stop", LATCHED])
def test_with_two_publishers_of_a_stop_nothing_is_known(stop):
    world = world_of(stop=stop)
    world.tell(publisher(True, "a", source=b"a"))
    world.hear("stop", encode(BOOL, data=False), b"a")
    assert unknown(world) == ""
    world.tell(publisher(True, "b", source=b"b"))
    two = "stop: it has 2 publishers (/estop), expected one"
    assert unknown(world) == two
    world.hear("stop", encode(BOOL, data=False), b"b")
    world.tell(publisher(False, "a", source=b"a"))
    assert unknown(world) == ("" if stop == LATCHED else two)
    for _ in range(4):
        world.run(1.0)
        world.hear("stop", encode(BOOL, data=False), b"b")
    assert unknown(world) == ""
    world.hear("stop", encode(BOOL, data=False), b"stranger")  # without a token
    assert unknown(world) == two


@pytest.mark.parametrize("stop", ["stop", LATCHED])
def test_a_stop_of_another_type_that_can_be_read_as_the_described_one_does_not_count(stop):
    world = world_of(stop=stop)
    world.tell(publisher(True, ros_type=UINT8))
    world.hear("stop", encode(UINT8, data=0))
    assert f"it has the type {UINT8}, expected {BOOL}" in unknown(world)
