"""The ROS 2 base driver on a virtual clock; its robot encodes and decodes with an independent library."""

import math

import pytest
import ros_cdr
from ros_cdr import BatteryState, Imu, LaserScan, Quaternion, String, Twist, TwistStamped, Vector3, odometry

from bridge.base import BaseReport, Failed, Lost, Ready, Recovered, Setpoint, TurnRate
from bridge.inbox import RobotMessage
from bridge.ros.discovery import Announced, read_topic_token, topic_token
from bridge.ros.rmw import Graph, Topic, read_token
from bridge.ros_base.address import RosAddress, parse_address
from bridge.ros_base.base import LoopSeen, Ros2Base, TokenSeen
from bridge.ros_base.silence import Silence
from bridge.ros_base.silence_file import SilenceFile
from rover_ncp.core.errors import UsageError
from rover_ncp.core.geometry import Velocity
from rover_ncp.core.messages import twist
from rover_ncp.core.robot_description import load_description

BURGER = load_description("turtlebot3-burger")
EPOCH_S = 1.7e9
OURS = b"o" * 16


class Line:
    """A session that keeps what is sent."""

    endpoint, zid, source = "tcp/robot:7447", "ours", OURS

    def __init__(self):
        self.sent, self.closed = [], False

    def topic(self, name):
        return name

    def publish(self, payload):
        assert not self.closed
        self.sent.append(payload)

    def close(self):
        self.closed = True


class World:
    """A base, a line and a clock; ``events`` is all that happened, reports apart."""

    def __init__(self, description=BURGER):
        self.line, self.now = Line(), 100.0
        self.stored = []
        self.base = Ros2Base(self.line, description, Silence(), self.stored.append)
        self.events, self.reports, self.turns = [], [], []
        self.x = self.setpoint_v = 0.0
        self.clock_s = EPOCH_S

    def keep(self, events):
        for event in events:
            kind = {BaseReport: self.reports, TurnRate: self.turns}.get(type(event), self.events)
            kind.append(event)

    def tell(self, arrival):
        self.keep(self.base.receive(arrival, self.now))

    def hear(self, topic, payload, source=None):
        self.tell(RobotMessage(topic, payload, self.now, source))

    def odom(self, source=None, **values):
        self.hear("odom", odometry(self.clock_s + self.now, **{"x": self.x, **values}), source)

    def run(self, seconds, odom=True, rate_hz=20.0, each=None, **values):
        """Let time pass in ticks of 10 ms."""
        due_s = self.now
        for _ in range(round(seconds * 100)):
            self.now += 0.01
            self.x += 0.01 * self.setpoint_v
            if odom and self.now >= due_s - 1e-9:
                due_s += 1 / rate_hz
                self.odom(**{"v": self.setpoint_v, **values})
            if each:
                each()
            setpoint = Setpoint(Velocity(self.setpoint_v, 0.0), True, False)
            self.keep(self.base.drive(setpoint, self.now))
        return self

    @property
    def last(self):
        return self.events[-1] if self.events else None


@pytest.fixture
def world():
    return World()


@pytest.fixture
def ready(world):
    world.run(2.0)
    assert [type(event) for event in world.events] == [Ready]
    return world


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
    world.base.close(world.now)
    assert world.line.closed


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


# Bad input.


def announced(topic, ros_type, who="robot", published=True):
    return TokenSeen(Announced("theirs", published, topic, ros_type, who), True)


def test_missing_odometry_is_named_with_what_is_there(world):
    world.tell(announced("odometry/filtered", "nav_msgs/msg/Odometry"))
    world.run(7.0, odom=False)
    assert world.last.reason.startswith("tcp/robot:7447: no nav_msgs/msg/Odometry arrives on odom")
    assert "published there: odometry/filtered" in world.last.reason


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


@pytest.mark.parametrize("values", [{"x": math.nan}, {"v": math.inf}, {"theta": math.nan}])
def test_odometry_that_is_not_finite_stops_it(ready, values):
    ready.run(1.0, **values)
    assert ready.last == Lost("odometry is not finite")
    assert all(math.isfinite(report.x) for report in ready.reports)


def test_a_quaternion_of_zeros_is_no_heading(ready):
    message = ros_cdr.Odometry.deserialize(odometry(EPOCH_S + ready.now + 1))
    message.pose.pose.orientation = Quaternion(0.0, 0.0, 0.0, 0.0)
    ready.run(0.7, odom=False, each=lambda: ready.hear("odom", message.serialize()))
    assert ready.last == Lost("odometry is not finite")


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


# Scans.


def scan(*hits, first_deg=0.0, count=360, step_deg=1.0):
    """Return a LaserScan's bytes; ``hits`` are (degrees from the laser's x-axis, range in m)."""
    ranges = [math.inf] * count
    for degrees, range_m in hits:
        ranges[round((degrees - first_deg) / step_deg) % 360] = range_m
    return LaserScan(
        angle_min=math.radians(first_deg),
        angle_increment=math.radians(step_deg),
        range_min=0.1,
        range_max=8.0,
        ranges=ranges,
    ).serialize()


@pytest.mark.parametrize(
    ("payload", "ahead", "behind"),
    [
        # The Burger's laser is 0.032 m behind its centre; its outline ends 0.041 m before it, 0.105 m behind.
        (scan((0, 1.0)), 1.0 - 0.032 - 0.041, math.inf),
        (scan((180, 1.0)), math.inf, 1.0 + 0.032 - 0.105),
        (scan((0, 1.0), (180, 0.5)), 0.927, 0.427),
        (scan((90, 0.3), (45, 0.5)), math.inf, math.inf),  # beside the way
        (scan((8, 1.0)), math.cos(math.radians(8)) - 0.073, math.inf),  # 0.139 m from the middle line
        (scan((10, 1.0)), math.inf, math.inf),  # 0.174 m
        (scan((0, 0.05)), math.inf, math.inf),  # below the least range
        (scan((0, math.nan)), math.inf, math.inf),
        (scan((0, 2.0), first_deg=-90.0, count=181), 2.0 - 0.073, math.nan),  # it looks ahead only
    ],
)
def test_room_by_a_scan_counts_from_the_outline(ready, payload, ahead, behind):
    ready.hear("scan", payload)
    ready.run(0.1)
    report = ready.reports[-1]
    assert report.clear_ahead_m == pytest.approx(ahead, abs=1e-3, nan_ok=True)
    assert report.clear_behind_m == pytest.approx(behind, abs=1e-3, nan_ok=True)


def test_posts_of_the_robots_own_are_no_obstacles(ready):
    ready.hear("scan", scan((180, 0.102), (0, 0.07)))  # 0.134 m behind its centre: outside; 0.038 m before it
    ready.run(0.1)
    assert ready.reports[-1].clear_ahead_m == math.inf
    assert ready.reports[-1].clear_behind_m == pytest.approx(0.029, abs=1e-3)


def test_an_old_scan_and_none_at_all_are_no_room(ready):
    assert math.isnan(ready.reports[-1].clear_ahead_m)
    ready.hear("scan", scan())
    ready.run(0.5)
    assert ready.reports[-1].clear_ahead_m == math.inf
    ready.run(1.0)
    assert math.isnan(ready.reports[-1].clear_ahead_m)


@pytest.mark.parametrize("payload", [b"", LaserScan().serialize(), LaserScan(ranges=[1.0]).serialize()])
def test_a_scan_that_is_none_is_counted(ready, payload):
    ready.hear("scan", payload)
    ready.run(0.1)
    assert math.isnan(ready.reports[-1].clear_ahead_m)
    assert ready.base.health().counters["unreadable"] == 1


def test_a_laser_that_looks_to_the_left_is_turned():
    world = World(load_description("turtlebot4"))
    world.run(2.0, frames=("odom", "base_link"))
    world.hear("scan", scan((-90, 1.0)))
    world.run(0.1, frames=("odom", "base_link"))
    assert world.reports[-1].clear_ahead_m == pytest.approx(1.0 - 0.04 - 0.171, abs=1e-3)


# Silence.


def halts(world, after_s):
    """Let a robot that drives 0.1 m/s halt so long after its last command."""
    world.setpoint_v = 0.1
    world.run(0.5)
    assert world.base.measure_timeout(world.now) == ""
    sent, began_s = len(world.line.sent), world.now
    world.setpoint_v = 0.0
    while world.base.own_timeout.state == "running":
        assert len(world.line.sent) == sent
        world.run(0.01, rate_hz=100.0, v=0.1 if world.now - began_s < after_s else 0.0)
        assert world.now - began_s < 6.0
    return world.base.own_timeout


def test_a_robot_that_is_not_checked_has_a_refusal(ready):
    known = ready.base.own_timeout
    assert known.state == "unknown"
    assert "rover-ncp check" in known.refusal


def test_the_robots_own_timeout_is_measured_while_nothing_is_sent(ready):
    known = halts(ready, 0.6)
    assert (known.state, known.refusal) == ("measured", "")
    assert known.timeout_s == pytest.approx(0.65, abs=0.08)  # counted from the last command before
    assert ready.stored == [ready.base.silence]
    ready.run(0.2)
    assert TwistStamped.deserialize(ready.line.sent[-1]).twist.linear.x == 0.0


def test_a_robot_that_does_not_halt_gets_zeros_after_5_s_and_a_refusal(ready):
    known = halts(ready, 100.0)
    assert (known.state, known.timeout_s) == ("none", None)
    assert "--no-base-watchdog" in known.refusal
    ready.run(0.1)
    assert TwistStamped.deserialize(ready.line.sent[-1]).twist.linear.x == 0.0


def test_a_stop_ends_the_measurement(ready):
    ready.setpoint_v = 0.1
    ready.run(0.5)
    assert ready.base.measure_timeout(ready.now) == ""
    ready.base.drive(Setpoint(Velocity(0.0, 0.0), True, emergency=True), ready.now + 0.01)
    assert ready.base.own_timeout.state == "unknown"
    assert TwistStamped.deserialize(ready.line.sent[-1]).twist.linear.x == 0.0


def test_wheels_that_stand_measure_nothing(ready):
    assert ready.base.measure_timeout(ready.now) == "the wheels do not turn by a command"


def test_wheels_that_roll_out_after_a_zero_measure_nothing(ready):
    ready.setpoint_v = 0.1
    ready.run(0.5)
    ready.setpoint_v = 0.0
    ready.run(0.02, v=0.1, rate_hz=100.0)
    assert ready.base.measure_timeout(ready.now) == "the wheels do not turn by a command"


def test_a_result_is_kept_for_the_robot_and_its_description(tmp_path):
    path, address = tmp_path / "state" / "robots.yaml", parse_address("ros2/tcp/robot")
    file = SilenceFile(path, address, BURGER)
    file.store(file.load(unsafe=False).measured(0.5))
    SilenceFile(path, parse_address("ros2/tcp/other"), BURGER).store(Silence().measured(None))
    assert file.load(unsafe=False) == Silence().measured(0.5)
    assert SilenceFile(path, address, load_description("turtlebot4")).load(unsafe=False) == Silence()
    slower = BURGER.model_copy(update={"mass_kg": 2.0})
    assert SilenceFile(path, address, slower).load(unsafe=False) == Silence()
    path.write_text("robots: 3")
    with pytest.raises(UsageError, match=r"\$.robots"):
        file.load(unsafe=False)


# Addresses and tokens.


def test_addresses():
    assert parse_address("ros2/tcp/robot") == RosAddress("tcp/robot:7447")
    found = parse_address("ros2/tcp/[::1]:8000#rmw=zenoh&domain=7&namespace=/a200_0001")
    assert (found.endpoint, found.domain, found.topic("odom")) == ("tcp/[::1]:8000", 7, "a200_0001/odom")
    assert found.convention == "rmw-zenoh"


@pytest.mark.parametrize(
    "text",
    [
        *("ros2/", "ros2/tcp/", "ros2/udp/x", "ros2/tcp/x:0", "ros2/tcp/x:y", "ros2/tcp/x#rmw=dds"),
        *("ros2/tcp/x#domain=-1", "ros2/tcp/x#domain=233", "ros2/tcp/x#speed=9", "ros2/tcp/x#domain=²"),
    ],
)
def test_bad_addresses_are_refused(text):
    with pytest.raises(UsageError, match="expected ros2/tcp/HOST"):
        parse_address(text)


def test_tokens_are_read_as_they_are_written():
    token = topic_token("abc", "bot1/cmd_vel", "geometry_msgs/msg/Twist", published=True)
    assert read_topic_token(token) == Announced(
        "abc", True, "bot1/cmd_vel", "geometry_msgs/msg/Twist", "zenoh-bridge-ros2dds abc"
    )
    graph = Graph(3, "abc", "bot1", "teleop")
    found = read_token(graph.subscriber_token(5, Topic("bot1/cmd_vel", "geometry_msgs/msg/TwistStamped")))
    assert found == Announced("abc", False, "bot1/cmd_vel", "geometry_msgs/msg/TwistStamped", "/bot1/teleop")
    assert read_token(graph.node_token()) is None
    assert read_topic_token("@/abc/@ros2_lv") is None
