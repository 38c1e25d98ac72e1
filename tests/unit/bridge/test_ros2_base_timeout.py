"""What a ROS 2 robot does without commands: the measurement, and what lifts the refusal to serve it."""

import pytest
from kit.described import described

from bridge.base import BaseReport
from bridge.gate.limits import Fence
from bridge.measure_timeout import measure, words_for
from bridge.ros2.base_timeout import Phase, TimeoutMeasurement
from rover_ncp.core.errors import SafetyStop
from sim.base.ros2_robot import Ros2Robot
from sim.stack.lines import WALL_NS, Ros2Connection
from sim.world.described import described_rover
from sim.world.pymunk_rover import Ground, PymunkRover


def measured(speed_after, *, rate_hz=20.0, moves=None):
    """Measure a robot that drives 0.1 m/s, then ``speed_after(seconds of silence)``, by perfect odometry.

    ``moves`` is the true speed where odometry reports another one.
    """
    found, now, sent_s, x = TimeoutMeasurement(0.0), 0.0, 0.0, 0.0
    while found.phase in {Phase.DRIVE, Phase.SILENT}:
        now += 1.0 / rate_hz
        silent = found.phase is Phase.SILENT
        v = speed_after(now - sent_s) if silent else 0.1
        x += (v if moves is None or not silent else moves(now - sent_s)) / rate_hz
        sent_s = sent_s if silent else now
        found.take(BaseReport(x=x, v=v), now)
        found.tick(now, sent_s)
        assert now < 10.0
    return found


@pytest.mark.parametrize(
    ("reported", "moves"),
    [
        (lambda s: 0.045, None),
        (lambda s: 0.0 if 0.5 < s < 0.56 else 0.1, None),
        (lambda s: 0.0, lambda s: 0.1),
        (lambda s: 0.1, lambda s: 0.0),
        (lambda s: 0.1 if s % 1.2 < 0.6 else 0.0, None),
    ],
    ids=["slows to 45 %", "one low report", "moves while it reports 0", "frozen pose", "stops and starts"],
)
def test_a_robot_that_is_not_still_has_no_timeout(reported, moves):
    assert measured(reported, moves=moves).phase is Phase.DRIVES_ON


class Robot:
    """A simulated robot behind a base on a virtual clock, which nothing but the measurement drives."""

    def __init__(self, timeout_s, model="turtlebot3-burger"):
        robot = described(model, topics={"cmd_vel_timeout_s": timeout_s})
        self.robot = Ros2Robot(robot, PymunkRover(described_rover(robot), Ground(())))
        self.line = Ros2Connection(self.robot, None)
        self.now_s, self.act, self.began_s = 0.0, lambda: None, []

    def monotonic(self):
        return self.now_s

    def monotonic_ns(self):
        return round(self.now_s * 1e9)

    def time_ns(self):
        return WALL_NS + self.monotonic_ns()

    def take(self, timeout_s):
        self.now_s += max(min(timeout_s, self.line.due_s - self.now_s), 1e-6)
        self.line.advance(self.now_s)
        self.act()
        arrived = [(self.now_s, arrival) for arrival in self.line.arrivals]
        self.line.arrivals.clear()
        return arrived

    @property
    def speed(self):
        return self.robot.drive.measured.v

    def measure(self, stopping=lambda: False, fence=None):
        base, limits = self.line.base, self.line.limits.model_copy(update={"fence": fence})
        found = measure(
            *(base, self, limits, stopping),
            begins=lambda: self.began_s.append(self.now_s),
            clock=self,
            total_suspended_s=lambda: 0.0,
        )
        assert len(self.began_s) == 1
        return found

    def stands_soon(self):
        """Let the line time pass without the bridge; return whether the robot stands then."""
        for _ in range(100):
            self.take(0.01)
        return abs(self.speed) < 0.01


@pytest.mark.parametrize(("timeout_s", "model"), [(0.5, "husky-a200"), (1.5, "turtlebot3-burger")])
def test_a_robot_is_measured_through_the_gate_and_gets_the_line(timeout_s, model):
    robot = Robot(timeout_s, model)
    found = robot.measure()
    assert timeout_s <= found.timeout_s <= timeout_s + 0.4  # braking, and what cannot be resolved
    assert found.line.startswith(f"measured_base_timeout_s: {found.timeout_s:g} # ")
    assert found.line in words_for(found)


def test_a_robot_without_a_timeout_gets_no_line_and_stands_afterwards():
    robot = Robot(None)
    found = robot.measure()
    assert (found.timeout_s, found.line) == (None, "")
    assert "--no-base-watchdog" in words_for(found)
    assert robot.stands_soon()


@pytest.mark.parametrize("x_max", [0.16, 0.3], ids=["before the silence", "in the silence"])
def test_a_robot_that_the_fence_halts_is_not_measured(x_max):
    robot = Robot(None)
    with pytest.raises(SafetyStop, match="not measured: the rover would leave the geofence"):
        robot.measure(fence=Fence(x_min=-1.0, x_max=x_max, y_min=-1.0, y_max=1.0))
    assert robot.stands_soon()
    assert robot.robot.drive.rover.pose.x < x_max


@pytest.mark.parametrize("silent", [False, True])
def test_odometry_that_stops_ends_the_measurement_and_the_robot_stands(silent):
    robot = Robot(None)
    robot.act = lambda: robot.line.arrivals.clear() if robot.lost else None
    before = robot.take

    def take(timeout_s):
        robot.lost |= robot.line.base.silent is silent and robot.speed > 0.09
        return before(timeout_s)

    robot.lost, robot.take = False, take
    with pytest.raises(SafetyStop, match=r"not measured: .* odometry is stale"):
        robot.measure()
    robot.take = before
    assert robot.stands_soon()


def test_an_interrupted_measurement_stops_the_robot():
    robot, moving_s = Robot(None), []

    def stopping():
        moving_s.extend([robot.now_s] if robot.speed > 0.09 else [])
        return bool(moving_s) and robot.now_s > moving_s[0] + 1.0

    with pytest.raises(KeyboardInterrupt):
        robot.measure(stopping)
    assert moving_s[-1] == robot.now_s
    assert robot.stands_soon()


def test_a_robot_whose_stop_topic_is_silent_is_not_measured():
    robot = Robot(0.5, "husky-a200")

    def act():
        arrivals = robot.line.arrivals
        arrivals[:] = [found for found in arrivals if found.topic != "platform/emergency_stop"]

    robot.act = act
    with pytest.raises(SafetyStop, match="emergency_stop: no message has come"):
        robot.measure()
    assert not robot.began_s
