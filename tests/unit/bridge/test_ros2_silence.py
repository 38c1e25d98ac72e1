"""What a ROS 2 robot does without commands: the measurement, and the file that keeps it."""

import pytest
from ros2_world import BURGER
from ros_cdr import TwistStamped

from bridge.base import Setpoint
from bridge.ros_base.address import parse_address
from bridge.ros_base.silence import Silence
from bridge.ros_base.silence_file import SilenceFile
from rover_ncp.core.errors import UsageError
from rover_ncp.core.geometry import Velocity
from rover_ncp.core.robot_description import load_description


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
