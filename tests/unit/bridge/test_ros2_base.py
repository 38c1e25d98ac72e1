"""The ROS 2 base driver on a virtual clock; its robot encodes and decodes with an independent library."""

import gc
import math
import tracemalloc

import pytest
import ros_cdr
from ros2_world import BURGER, EPOCH_S, OURS, World
from ros_cdr import (
    BatteryState,
    Bool,
    HazardDetection,
    HazardDetectionVector,
    Imu,
    Quaternion,
    String,
    Twist,
    TwistStamped,
    Vector3,
    odometry,
    twist,
)

from bridge.base import Failed, Lost, Notice, Ready, Recovered
from bridge.ros2.base import LoopSeen, TokenSeen
from bridge.ros2.discovery import Announced
from bridge.ros2.odometry import RosOdometer
from rover_ncp.core.geometry import Velocity
from rover_ncp.robot.description import load_description


def test_it_is_ready_when_odometry_arrives_evenly(ready):
    assert ready.last.robot.name == "turtlebot3-burger"
    assert ready.last.robot.length_m == pytest.approx(0.146)


def test_the_pose_begins_at_zero_wherever_the_robot_is():
    world = World()
    world.x = 5.0
    world.run(2.0, y=3.0, theta=math.pi / 2)
    assert (world.reports[0].x, world.reports[0].y, world.reports[0].theta) == pytest.approx((0, 0, 0))
    world.run(0.2, y=4.0, theta=math.pi / 2)  # a metre along the y-axis, where it headed at first
    assert (world.reports[-1].x, world.reports[-1].y) == pytest.approx((1.0, 0.0))


def test_the_heading_is_not_wrapped(ready):
    turned = [0.0]

    def turn():
        turned[0] += 0.02

    ready.setpoint_v = 0.01
    for _ in range(100):
        ready.run(0.05, each=turn, theta=turned[0], omega=2.0)
    assert ready.reports[-1].theta == pytest.approx(turned[0], abs=0.3)
    assert ready.reports[-1].theta > 2 * math.pi


def test_a_twist_stamped_carries_the_robots_time(ready):
    ready.clock_s = EPOCH_S
    ready.setpoint_v = 0.1
    ready.run(0.1)
    sent = TwistStamped.deserialize(ready.line.sent[-1])
    assert sent.twist.linear.x == 0.1
    assert sent.twist.angular.z == 0.0
    assert sent.header.frame_id == "base_footprint"
    stamp_s = sent.header.stamp.sec + sent.header.stamp.nanosec * 1e-9
    assert stamp_s == pytest.approx(EPOCH_S + ready.now, abs=0.06)


def test_a_twist_has_the_velocity_and_nothing_else():
    world = World(load_description("turtlebot4"))
    world.setpoint_v = 0.25
    world.run(2.0, frames=("odom", "base_link"))
    sent = Twist.deserialize(world.line.sent[-1])
    assert (sent.linear.x, sent.linear.y, sent.linear.z) == (0.25, 0.0, 0.0)
    assert (sent.angular.x, sent.angular.y, sent.angular.z) == (0.0, 0.0, 0.0)


def test_zeros_are_sent_while_it_is_not_ready_and_at_the_end(world):
    world.setpoint_v = 0.2
    world.run(1.0, odom=False)
    assert len(world.line.sent) >= 15
    assert {TwistStamped.deserialize(data).twist.linear.x for data in world.line.sent} == {0.0}


def test_zeros_are_sent_for_a_while_before_the_session_ends(ready):
    ready.setpoint_v = 0.1
    ready.run(0.2)
    before = len(ready.line.sent)
    ready.base.close(ready.now)
    last = [TwistStamped.deserialize(data).twist.linear.x for data in ready.line.sent[before:]]
    assert last == [0.0] * 5
    assert ready.line.waited_s >= 0.2
    assert ready.line.closed


def last_stamp_s(world):
    stamp = TwistStamped.deserialize(world.line.sent[-1]).header.stamp
    return stamp.sec + stamp.nanosec * 1e-9


def test_the_end_of_the_clock_in_odometry_ends_nothing(ready):
    """A stamp of 2038 is valid; a moment later, the robot's clock no longer fits a stamp."""
    for late_s in (0.0, 0.05):
        ready.hear("odom", odometry(2**31 - 1 + late_s))
        ready.run(0.05, odom=False)
    ready.run(1.5, odom=False)
    assert last_stamp_s(ready) == pytest.approx(2**31, abs=1e-3)
    ready.base.close(ready.now)
    assert TwistStamped.deserialize(ready.line.sent[-1]).twist.linear.x == 0.0
    assert ready.line.closed


def test_a_stamp_with_more_than_a_second_of_nanoseconds_does_not_count(ready):
    message = ros_cdr.Odometry.deserialize(odometry(2**31 - 1))
    message.header.stamp.nanosec = 4_000_000_000
    ready.hear("odom", message.serialize())
    ready.run(0.2)
    assert ready.base.health().counters["unreadable"] == 1
    assert last_stamp_s(ready) == pytest.approx(EPOCH_S + ready.now, abs=0.06)
    assert [type(event) for event in ready.events] == [Ready]


def test_the_line_is_closed_even_if_it_does_not_take_the_last_zero(ready, monkeypatch):
    def fail(payload):
        raise OSError

    monkeypatch.setattr(ready.line, "publish", fail)
    with pytest.raises(OSError):
        ready.base.close(ready.now)
    assert ready.line.closed


def test_a_command_is_sent_again_at_20_hz(ready):
    ready.setpoint_v = 0.1
    before = len(ready.line.sent)
    ready.run(2.0)
    assert len(ready.line.sent) - before == pytest.approx(40, abs=8)


def test_gyro_and_battery_are_passed_on(ready):
    ready.hear("imu", Imu(angular_velocity=Vector3(z=0.2)).serialize())
    ready.hear("imu", Imu(angular_velocity=Vector3(z=0.4)).serialize())
    ready.hear("imu", Imu(angular_velocity=Vector3(z=math.nan)).serialize())
    ready.hear("battery_state", BatteryState(voltage=11.5, power_supply_status=1).serialize())
    ready.run(0.1)
    assert ready.turns[-1].rate == pytest.approx(0.3)
    assert ready.reports[-1].battery_v == pytest.approx(11.5)
    assert ready.reports[-1].charging is True


@pytest.mark.parametrize("pressed", [True, False])
def test_a_stop_button_and_hazards_are_passed_on(pressed):
    topics = BURGER.topics.model_copy(update={"stop": "stop", "hazards": "hazard_detection"})
    world = World(BURGER.model_copy(update={"topics": topics}))
    found = [HazardDetection(type=kind) for kind in ((1, 3) if pressed else (0, 5))]
    world.run(2.0)
    world.hear("stop", Bool(pressed).serialize())
    world.hear("hazard_detection", HazardDetectionVector(detections=found).serialize())
    world.run(0.1)
    report = world.reports[-1]
    assert (report.stop_pressed, report.stalled[0], any(report.bumpers)) == (pressed,) * 3


# Bad input.


def announced(topic, ros_type, who="robot", published=True):
    return TokenSeen(Announced("theirs", published, topic, ros_type, who), True)


def test_missing_odometry_is_named_with_what_is_there(world):
    world.tell(announced("odometry/filtered", "nav_msgs/msg/Odometry"))
    world.run(7.0, odom=False)
    assert world.last.reason.startswith("tcp/robot:7447: no nav_msgs/msg/Odometry arrives on odom")
    assert "published there: odometry/filtered" in world.last.reason


def test_the_bridges_own_topics_are_not_named_as_the_robots(world):
    world.tell(announced("wheel/odom", "nav_msgs/msg/Odometry"))
    world.tell(TokenSeen(Announced("ours", True, "cmd_vel", "geometry_msgs/msg/Twist", "the bridge"), True))
    world.run(7.0, odom=False)
    assert world.last.reason.endswith("published there: wheel/odom")


def test_an_announced_type_that_is_not_odometry_is_named(world):
    world.tell(announced("odom", "geometry_msgs/msg/PoseStamped"))
    world.run(7.0, odom=False)
    assert "odom has the type geometry_msgs/msg/PoseStamped" in world.last.reason


def test_a_robot_that_takes_another_type_of_command_is_not_driven(world):
    world.tell(announced("cmd_vel", "geometry_msgs/msg/Twist", published=False))
    world.run(7.0)
    assert isinstance(world.last, Failed)
    assert "the robot takes geometry_msgs/msg/Twist on cmd_vel" in world.last.reason
    assert "now geometry_msgs/msg/TwistStamped" in world.last.reason


@pytest.mark.parametrize(
    "payload",
    [b"", b"\0\1\0\0", String("x" * 800).serialize(), odometry(EPOCH_S)[:-9], b"\0\1\0\0" + b"\xff" * 900],
)
def test_bytes_that_are_no_odometry_never_make_it_ready(world, payload):
    world.run(7.0, odom=False, each=lambda: world.hear("odom", payload))
    assert isinstance(world.last, Failed)
    assert "odom" in world.last.reason
    assert not world.reports


@pytest.mark.parametrize("values", [{"x": math.nan}, {"v": math.inf}, {"x": math.inf, "theta": math.nan}])
def test_odometry_that_is_not_finite_stops_it(ready, values):
    ready.run(1.0, **values)
    assert ready.last == Lost("odometry is not finite")
    assert all(math.isfinite(report.x) for report in ready.reports)


@pytest.mark.parametrize("w", [0.0, 0.5])
def test_invalid_quaternion_is_named_as_no_rotation(ready, w):
    message = ros_cdr.Odometry.deserialize(odometry(EPOCH_S + ready.now + 1))
    message.pose.pose.orientation = Quaternion(0.0, 0.0, 0.0, w)
    ready.run(0.7, odom=False, each=lambda: ready.hear("odom", message.serialize()))
    assert ready.last == Lost(f"odometry cannot be read: the orientation 0, 0, 0, {w:g} is not a rotation")


def test_a_covariance_of_nan_changes_nothing(ready):
    def send():
        message = ros_cdr.Odometry.deserialize(odometry(EPOCH_S + ready.now))
        message.pose.covariance = message.twist.covariance = [math.nan] * 36
        ready.hear("odom", message.serialize())

    ready.run(2.0, odom=False, each=send)
    assert [type(event) for event in ready.events] == [Ready]


def test_odometry_of_another_frame_is_named(world):
    world.run(7.0, frames=("map", "base_link"))
    assert "odometry is of map → base_link, expected odom → base_footprint" in world.last.reason


def test_a_robots_prefix_before_its_frames_is_accepted(world):
    world.run(2.0, frames=("robot1/odom", "robot1/base_footprint"))
    assert isinstance(world.last, Ready)


def test_odometry_at_1_hz_is_named(world):
    world.run(7.0, rate_hz=1.0)
    assert "odometry on odom arrives 1.0 times a second, expected 5 or more" in world.last.reason


def test_odometry_at_200_hz_is_passed_on_at_50(world):
    for _ in range(1000):
        world.now += 0.005
        world.odom()
    assert isinstance(world.last, Ready)
    assert 0.0 < len(world.reports) <= 5.0 * 56


def test_jitter_does_not_lose_it(ready):
    late = [0.0, 0.06, 0.01, 0.08, 0.03]
    for k in range(100):
        stamp_s = EPOCH_S + ready.now
        ready.run(late[k % 5], odom=False)
        ready.hear("odom", odometry(stamp_s))
        ready.run(0.05, odom=False)
    assert [type(event) for event in ready.events] == [Ready]


def test_bursts_of_old_odometry_do_not_count(ready):
    for _ in range(6):
        first_s = EPOCH_S + ready.now
        ready.run(1.0, odom=False)
        for k in range(20):
            ready.hear("odom", odometry(first_s + 0.05 * k))
    assert isinstance(ready.events[1], Lost)
    assert len(ready.events) == 2  # it does not recover between bursts


def test_two_publishers_of_odometry_stop_it(ready):
    """Two robots on one topic, without any sign of who sent what."""

    def other():
        ready.hear("odom", odometry(EPOCH_S + ready.now + 0.001, x=3.0, y=2.0))

    ready.run(1.0, each=other)
    assert ready.last == Lost("two publishers on odom")
    ready.run(5.0)
    assert isinstance(ready.last, Ready | Recovered)


def test_two_nodes_that_publish_odometry_are_named(ready):
    ready.tell(announced("odom", "nav_msgs/msg/Odometry", "/ekf"))
    ready.tell(announced("odom", "nav_msgs/msg/Odometry", "/wheels"))

    def both():
        ready.odom(source=b"a" * 16)
        ready.now += 0.001
        ready.odom(source=b"b" * 16)

    ready.run(0.5, odom=False, each=both)
    assert ready.last == Lost("two publishers on odom: /ekf and /wheels")


def test_publishers_with_ever_new_identities_take_no_memory():
    """Any peer of the robot's network may choose the 16 bytes of its identity."""
    odometer, payload = RosOdometer(BURGER.topics, BURGER.motion), odometry(EPOCH_S)
    held = []
    tracemalloc.start()
    for k in range(2000):
        odometer.take(payload, 0.01 * k, k.to_bytes(16, "little"))
        if k in {499, 1999}:
            gc.collect()
            held.append(tracemalloc.get_traced_memory()[0])
    grown = held[1] - held[0]
    tracemalloc.stop()
    assert grown < 10_000
    assert odometer.publishers(20.5) > 1
    assert odometer.publishers(21.5) == 1


def test_a_second_publisher_of_commands_stops_it_and_is_named(ready):
    ready.tell(announced("cmd_vel", "geometry_msgs/msg/Twist", "/teleop_twist_joy"))
    ready.setpoint_v = 0.1
    ready.run(0.5)
    ready.hear("cmd_vel", twist(Velocity(0.0, 0.0)))
    assert ready.last == Lost("/teleop_twist_joy publishes cmd_vel too")
    ready.run(0.1)
    assert TwistStamped.deserialize(ready.line.sent[-1]).twist.linear.x == 0.0
    ready.setpoint_v = 0.0
    ready.run(3.0)
    assert isinstance(ready.last, Recovered)


def test_its_own_commands_that_come_back_keep_it_from_starting(world):
    world.run(7.0, each=lambda: world.hear("cmd_vel", world.line.sent[-1]) if world.line.sent else None)
    assert isinstance(world.last, Failed)
    assert "the bridge's own commands on cmd_vel come back to it" in world.last.reason


def test_its_own_identity_in_a_command_is_not_a_foreign_publisher(world):
    world.run(7.0, each=lambda: world.hear("cmd_vel", twist(Velocity(0.3, 0.0)), OURS))
    assert "come back" in world.last.reason


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
    def move():
        ready.x += 0.002

    ready.run(2.0, each=move, v=0.2)
    assert "the robot drives although the bridge sends zeros" in ready.last.reason


@pytest.mark.parametrize("hours", [-3, 0, 5])
def test_the_robots_clock_may_be_hours_off(hours):
    world = World()
    world.clock_s = EPOCH_S + 3600 * hours
    world.run(3.0)
    assert [type(event) for event in world.events] == [Ready]


def test_a_clock_that_is_set_back_is_a_restart(ready):
    ready.clock_s -= 3600
    ready.run(3.0)
    assert [type(event) for event in ready.events] == [Ready, Lost, Ready]


def test_a_router_that_restarts_loses_the_base_and_the_pose_goes_on(ready):
    ready.x = 0.5
    ready.run(0.2)
    ready.run(3.0, odom=False)
    assert ready.last == Lost("no odometry on odom for 0.5 s")
    ready.run(2.0)
    assert isinstance(ready.last, Recovered)
    assert ready.reports[-1].x == pytest.approx(0.5)


def test_a_robot_that_restarts_begins_again_at_zero(ready):
    ready.x = 3.0
    ready.run(0.2)
    ready.run(3.0, odom=False)
    ready.x = 0.0
    ready.run(2.0)
    assert isinstance(ready.last, Ready)
    assert ready.reports[-1].x == pytest.approx(0.0)


# Clocks that are set, stamps that are bad, robots that restart.


def gaps_s(world, seconds):
    """Return the longest time without a report."""
    seen, longest, last_s = len(world.reports), 0.0, world.now
    for _ in range(round(seconds * 100)):
        world.run(0.01, odom=False)
        if round(world.now * 100) % 5 == 0:
            world.odom()
        if len(world.reports) > seen:
            seen, last_s = len(world.reports), world.now
        longest = max(longest, world.now - last_s)
    return longest


@pytest.mark.parametrize("back_s", [0.2, 0.3, 0.6, 1.0])
def test_a_clock_that_is_set_back_a_little_costs_one_message_and_is_named(ready, back_s):
    ready.x = 0.4
    ready.run(0.5)
    ready.clock_s -= back_s
    assert gaps_s(ready, 3.0) < 0.12
    notice = Notice(f"the clock that stamps odom was set back by {back_s:.2f} s")
    assert ready.events[1:] == [notice]
    assert ready.reports[-1].x == pytest.approx(0.4)
    assert last_stamp_s(ready) == pytest.approx(ready.clock_s + ready.now, abs=0.06)


@pytest.mark.parametrize("back_s", [1.5, 3600.0])
def test_a_clock_that_is_set_back_far_is_a_restart_that_names_it(ready, back_s):
    ready.clock_s -= back_s
    ready.run(3.0)
    assert ready.events[1] == Lost(f"odometry on odom began again: its clock was set back by {back_s:.2f} s")
    assert isinstance(ready.last, Ready)
    assert last_stamp_s(ready) == pytest.approx(ready.clock_s + ready.now, abs=0.06)


@pytest.mark.parametrize("ahead_s", [0.2, 0.6, 3600.0])
def test_a_clock_that_is_set_forward_costs_one_message(ready, ahead_s):
    ready.clock_s += ahead_s
    assert gaps_s(ready, 3.0) < 0.12
    assert len(ready.events) == 1


@pytest.mark.parametrize("error_s", [-1.7e9, -3600.0, -0.5, 0.5, 5.0, 4e8])
def test_a_bad_stamp_costs_one_message(ready, error_s):
    ready.clock_s += error_s
    ready.run(0.02)
    ready.clock_s -= error_s
    assert gaps_s(ready, 3.0) < 0.12
    assert len(ready.events) == 1
    assert ready.base.health().counters["stale"] == 1
    assert last_stamp_s(ready) == pytest.approx(ready.clock_s + ready.now, abs=0.06)


def test_a_link_that_became_slow_stays_lost(ready):
    stamps = []

    def send_late():
        stamps.append(EPOCH_S + ready.now)
        if len(stamps) > 60:
            ready.hear("odom", odometry(stamps.pop(0)))

    ready.run(20.0, odom=False, each=send_late)
    assert [type(event) for event in ready.events] == [Ready, Lost]
    assert ready.base.health().counters["stale"] > 1000


def test_two_publishers_with_clocks_apart_stop_it(ready):
    def other():
        ready.hear("odom", odometry(EPOCH_S + ready.now - 100.0))

    ready.run(1.0, rate_hz=100.0, each=other)
    assert ready.last == Lost("two publishers on odom")


@pytest.mark.parametrize(
    "new", [{"x": 0.0}, {"x": 0.6, "theta": 0.5}, {"x": 0.6, "y": 0.3}, {"x": 0.6, "theta": -math.pi}]
)
@pytest.mark.parametrize("silent_s", [0.8, 3.5, 60.0])
def test_a_robot_that_restarts_elsewhere_is_not_taken_for_the_old_one(ready, new, silent_s):
    """It was sent zeros while it was silent, so it cannot have driven there."""
    ready.setpoint_v = 0.2
    ready.run(3.0)
    assert ready.x == pytest.approx(0.6)
    ready.setpoint_v = 0.0
    ready.run(silent_s, odom=False)
    ready.run(2.0, **new)
    assert isinstance(ready.last, Ready)
    assert (ready.reports[-1].x, ready.reports[-1].y, ready.reports[-1].theta) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("coasted_m", [0.0, 0.1])
def test_a_robot_that_coasts_while_it_is_silent_keeps_its_odometry(ready, coasted_m):
    ready.setpoint_v = 0.2
    ready.run(3.0)
    ready.setpoint_v = 0.0
    ready.run(3.5, odom=False)
    ready.x += coasted_m
    ready.run(2.0)
    assert isinstance(ready.last, Recovered)
    assert ready.reports[-1].x == pytest.approx(0.6 + coasted_m)


@pytest.mark.parametrize("silent_s", [0.2, 0.7, 3.0])
def test_a_new_publisher_of_odometry_is_a_restart(world, silent_s):
    """Its identity is that of rmw_zenoh; the pose is near the old one."""
    world.run(2.0, source=b"a" * 16)
    world.x = 0.03
    world.run(silent_s, odom=False)
    world.run(5.0, source=b"b" * 16)
    assert isinstance(world.events[-2], Lost)
    assert isinstance(world.last, Ready)
    assert world.reports[-1].x == 0.0
