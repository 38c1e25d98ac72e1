"""What a ROS 2 robot does without commands: the measurement, and the file that keeps it."""

import threading

import pytest
from ros2_world import BURGER, World
from ros_cdr import TwistStamped

from bridge.base import Lost, Notice, Setpoint
from bridge.ros_base.address import parse_address
from bridge.ros_base.silence import NotStored, Silence
from bridge.ros_base.silence_file import SilenceFile
from rover_ncp.core.errors import UsageError
from rover_ncp.core.geometry import Velocity
from rover_ncp.core.messages import twist
from rover_ncp.core.robot_description import load_description


def begin(world):
    """Begin the measurement of a robot that drives 0.1 m/s."""
    world.setpoint_v = 0.1
    world.run(0.5)
    assert world.base.measure_timeout(world.now) == ""
    world.setpoint_v = 0.0


def halts(world, after_s):
    """Let a robot that drives 0.1 m/s halt so long after its last command."""
    begin(world)
    sent, began_s = len(world.line.sent), world.now
    while world.base.own_timeout.state == "running":
        turns = world.now - began_s < after_s
        world.run(0.01, rate_hz=100.0, v=0.1 if turns else 0.0)
        if turns and world.base.own_timeout.state == "running":
            assert len(world.line.sent) == sent
        assert world.now - began_s < 8.0
    return world.base.own_timeout


def last_v(world):
    return TwistStamped.deserialize(world.line.sent[-1]).twist.linear.x


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
    assert last_v(ready) == 0.0


def test_no_driver_drives_a_checked_robot_while_it_is_measured_again(ready):
    ready.base.silence = Silence().measured(0.6)
    assert ready.base.own_timeout.refusal == ""
    begin(ready)
    assert ready.base.own_timeout.refusal != ""  # the base would send it neither commands nor zeros
    halts(ready, 0.6)
    assert ready.base.own_timeout.refusal == ""


def test_a_robot_that_does_not_halt_gets_zeros_after_5_s_and_a_refusal(ready):
    known = halts(ready, 100.0)
    assert (known.state, known.timeout_s) == ("none", None)
    assert "--no-base-watchdog" in known.refusal
    ready.run(0.1)
    assert last_v(ready) == 0.0


def test_a_stop_ends_the_measurement(ready):
    begin(ready)
    ready.base.drive(Setpoint(Velocity(0.0, 0.0), True, emergency=True), ready.now + 0.01)
    assert ready.base.own_timeout.state == "unknown"
    assert last_v(ready) == 0.0


@pytest.mark.parametrize("late_s", [0.0, 0.05, 1.2])
def test_a_robot_that_a_stop_halts_is_not_measured(ready, late_s):
    """The wheels stand when the stop is pressed; the flag comes with that, or later."""
    begin(ready)
    ready.run(1.2, rate_hz=100.0, v=0.1)
    if late_s:
        ready.run(late_s, rate_hz=100.0, v=0.0)
        assert last_v(ready) == 0.0  # the silence has ended all the same
    ready.emergency = True
    ready.run(0.1, rate_hz=100.0, v=0.0)
    ready.emergency = False
    ready.run(3.0)
    assert ready.base.own_timeout.state == "unknown"
    assert not ready.stored


def test_a_robot_that_another_publishers_zero_halts_is_not_measured(ready):
    begin(ready)
    ready.run(0.5, rate_hz=100.0, v=0.1)
    ready.hear("cmd_vel", twist(Velocity(0.0, 0.0)))
    assert isinstance(ready.last, Lost)
    ready.run(5.0, v=0.0)
    assert ready.base.own_timeout.state == "unknown"
    assert not ready.stored


@pytest.mark.parametrize("after_s", [0.6, 100.0])
def test_a_zero_is_sent_before_the_result_is_stored(after_s):
    sent = []
    world = World(store=lambda _: sent.append(last_v(world)))
    world.run(2.0)
    halts(world, after_s)
    assert sent == [0.0]


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


def test_the_loop_does_not_wait_for_the_disk(tmp_path, monkeypatch):
    file = SilenceFile(tmp_path / "robots.yaml", parse_address("ros2/tcp/robot"), BURGER)
    disk, stored, store = threading.Event(), threading.Event(), file.store

    def slow(silence):
        assert disk.wait(10.0)
        store(silence)
        stored.set()

    monkeypatch.setattr(file, "store", slow)
    file.store_in_background(lambda arrival: None, Silence().measured(0.5))
    assert not file.path.exists()
    disk.set()
    assert stored.wait(10.0)
    assert file.load(unsafe=False) == Silence().measured(0.5)


def test_a_result_that_cannot_be_stored_is_a_message(ready, tmp_path):
    folder, reported, done = tmp_path / "state", [], threading.Event()
    folder.write_text("a file in place of the folder")
    file = SilenceFile(folder / "robots.yaml", parse_address("ros2/tcp/robot"), BURGER)
    file.store_in_background(lambda arrival: (reported.append(arrival), done.set()), Silence().measured(0.5))
    assert done.wait(10.0)
    assert isinstance(reported[0], NotStored)
    ready.tell(reported[0])
    assert isinstance(ready.last, Notice)
    assert f"{folder}/robots.yaml: cannot be written" in ready.last.text
