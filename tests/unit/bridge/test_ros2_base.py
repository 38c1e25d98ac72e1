"""The ROS 2 base on a virtual clock."""

import numpy as np
import pytest
from kit.ros2_world import BURGER, World, announced, twist

from bridge.base import Failed, Lost, PassedOn, Ready, Recovered
from bridge.ros2.discovery import Announced, LoopSeen, TokenSeen
from rover_ncp.core.geometry import Velocity
from rover_ncp.wire.cdr import encode
from rover_ncp.wire.messages import (
    DOCKED_TYPES,
    ODOMETRY,
    TWIST,
    TWIST_STAMPED,
    boolean,
)


@pytest.mark.parametrize("prefix", ["", "robot1/"])
def test_it_is_ready_when_odometry_arrives_evenly(world, prefix):
    world.run(2.0, frames=(f"{prefix}odom", f"{prefix}base_footprint"))
    assert world.events == [Ready("turtlebot3-burger on tcp/robot:7447", BURGER)]


def test_zeros_are_sent_while_it_is_not_ready(world):
    world.setpoint_v = 0.2
    world.run(1.0, odom=False)
    assert len(world.line.sent) >= 15
    assert set(world.sent_v()) == {0.0}


def test_command_is_sent_again_at_20_hz_and_zeros_for_a_while_before_the_session_ends(ready):
    ready.setpoint_v = 0.1
    before = len(ready.line.sent)
    ready.run(2.0)
    assert len(ready.line.sent) - before == pytest.approx(40, abs=8)
    before = len(ready.line.sent)
    ready.base.close(ready.now)
    assert ready.sent_v(before) == [0.0] * 5
    assert ready.line.waited_s >= 0.2
    assert ready.line.closed


@pytest.mark.parametrize(("field", "docked"), [("data", True), ("is_docked", False)])
def test_each_word_of_the_robot_that_it_is_docked_is_passed_on(field, docked):
    topics = BURGER.topics.model_copy(update={"docked": "dock", "docked_field": field})
    world = World(BURGER.model_copy(update={"topics": topics}))
    world.run(2.0)
    for _ in range(2):
        world.hear("dock", encode(DOCKED_TYPES[field], **{field: docked}))
    world.run(0.2)
    assert [event for event in world.events if isinstance(event, PassedOn)] == [
        PassedOn("docked", boolean(docked))
    ] * 2


# Bad input.


@pytest.mark.parametrize(
    ("token", "odom", "words"),
    [
        (
            announced("odometry/filtered", ODOMETRY),
            {"odom": False},
            f"no {ODOMETRY} arrives on odom; published there: odometry/filtered",
        ),
        (
            announced("cmd_vel", TWIST, published=False),
            {},
            f"the robot takes {TWIST} on cmd_vel: set topics.cmd_vel_type in the description, "
            f"now {TWIST_STAMPED}",
        ),
        (
            None,
            {"frames": ("map", "base_link")},
            "odometry is of map → base_link, expected odom → base_footprint: set "
            "topics.odom_frame and topics.base_frame in the description",
        ),
        (None, {"rate_hz": 1.0}, "odometry on odom arrives 1.0 times a second, expected 5 or more, evenly"),
    ],
)
def test_reason_of_a_robot_that_cannot_be_served_is_named(world, token, odom, words):
    world.tell(TokenSeen(Announced("ours", True, "cmd_vel", TWIST, "us"), True))
    if token:
        world.tell(token)
    world.run(7.0, **odom)
    assert world.last == Failed(f"tcp/robot:7447: {words}")


def test_a_second_publisher_of_commands_stops_it_and_is_named(ready):
    ready.tell(announced("cmd_vel", "geometry_msgs/msg/Twist", "/teleop_twist_joy"))
    ready.setpoint_v = 0.1
    ready.run(0.5)
    ready.hear("cmd_vel", twist(Velocity(0.0, 0.0)))
    assert ready.last == Lost("/teleop_twist_joy publishes cmd_vel too")
    ready.run(0.1)
    assert ready.sent_v()[-1] == 0.0
    ready.setpoint_v = 0.0
    ready.run(3.0)
    assert isinstance(ready.last, Recovered)


@pytest.mark.parametrize(("anew", "again"), [({}, Recovered), ({"x": 0.9}, Ready)])
def test_odometry_that_was_set_anew_while_the_base_was_lost_is_other_odometry(ready, anew, again):
    """A person drives by another node, and resets odometry: a fence is no longer where it was."""
    ready.hear("cmd_vel", twist(Velocity(0.1, 0.0)))
    assert isinstance(ready.last, Lost)
    ready.run(0.5)
    ready.run(3.0, **anew)
    assert isinstance(ready.last, again)


def test_its_own_commands_that_come_back_keep_it_from_starting(world):
    world.run(7.0, each=lambda: world.line.sent and world.hear("cmd_vel", world.line.sent[-1]))
    assert isinstance(world.last, Failed)
    assert "the bridge's own commands on cmd_vel come back to it" in world.last.reason


def test_connected_networks_keep_it_from_starting_and_stop_it_later(world):
    world.tell(LoopSeen(True))
    world.run(7.0)
    assert "the robot's Zenoh network is connected to the drivers'" in world.last.reason
    world.tell(LoopSeen(False))
    world.run(1.0)
    assert isinstance(world.last, Ready)
    world.tell(LoopSeen(True))
    assert isinstance(world.last, Lost)


def test_a_robot_that_drives_without_a_command_is_driven_by_another(ready):
    for ready.x in np.arange(0.0, 0.4, 0.02):
        ready.run(0.1, v=0.2)
    assert "the robot drives although the bridge sends zeros" in ready.last.reason
