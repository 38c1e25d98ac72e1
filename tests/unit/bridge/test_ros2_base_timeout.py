"""What a ROS 2 robot does without commands: the measurement, and what lifts the refusal to serve it."""

import pytest
from kit.driver_client import DriverClient
from kit.ros2_world import BURGER, World, twist
from kit.virtual_bench import VirtualRig

from bridge.base import Lost
from bridge.ros2.base_timeout import TimeoutRecord
from rover_ncp.core.errors import ConfigError
from rover_ncp.core.files import shipped_names
from rover_ncp.core.geometry import Velocity
from rover_ncp.robot.description import load_description
from rover_ncp.wire.protocol import BaseReply, BaseRequest, Signed, dump_json, parse_json

CHECKED = BURGER.model_copy(update={"measured_base_timeout_s": 0.6})


def begin(world, seconds=0.0):
    """Begin the measurement of a robot that drives 0.1 m/s, and let it turn its wheels for so long."""
    world.setpoint_v = 0.1
    world.run(0.5)
    assert world.base.measure_base_timeout(world.now) == ""
    world.setpoint_v = 0.0
    world.run(seconds, rate_hz=100.0, v=0.1)


def halts(world, after_s):
    """Let a robot that drives 0.1 m/s halt so long after its last command."""
    begin(world)
    sent, began_s = len(world.line.sent), world.now
    while world.base.base_timeout.state == "running":
        turns = world.now - began_s < after_s
        world.run(0.01, rate_hz=100.0, v=0.1 if turns else 0.0)
        if turns and world.base.base_timeout.state == "running":
            assert len(world.line.sent) == sent
        assert world.now - began_s < 8.0
    return world.base.base_timeout


@pytest.fixture
def checked():
    world = World(CHECKED)
    world.run(2.0)
    return world


def test_base_timeout_is_measured_while_nothing_is_sent_and_only_the_description_lifts_the_refusal(ready):
    assert ready.base.base_timeout.state == "unknown"
    assert "rover-ncp check" in ready.base.base_timeout.refusal
    known = halts(ready, 0.6)
    assert known.state == "measured"
    assert known.timeout_s == pytest.approx(0.65, abs=0.08)  # counted from the last command before
    ready.run(0.2)
    assert ready.sent_v()[-1] == 0.0
    assert "add the line that 'rover-ncp check' printed" in known.refusal
    assert World(CHECKED).base.base_timeout == ("measured", 0.6, "")


def test_no_driver_drives_a_checked_robot_while_it_is_measured_again(checked):
    begin(checked)
    assert checked.base.base_timeout.refusal != ""  # the base would send it neither commands nor zeros
    assert halts(checked, 0.6).refusal == ""


def interrupt(world):
    begin(world)
    world.lease = 0
    world.run(0.1)
    world.lease = 1


def test_an_interrupted_measurement_of_a_checked_robot_has_no_result_and_it_may_drive_on(checked):
    interrupt(checked)
    assert checked.base.base_timeout[::2] == ("unknown", "")
    assert halts(checked, 0.4).state == "measured"


def test_a_described_robot_that_does_not_halt_any_more_has_a_refusal(checked):
    assert "--no-base-watchdog" in halts(checked, 100.0).refusal
    interrupt(checked)
    assert "--no-base-watchdog" in checked.base.base_timeout.refusal


def test_a_robot_that_does_not_halt_gets_zeros_after_5_s_and_a_refusal(ready):
    known = halts(ready, 100.0)
    assert (known.state, known.timeout_s) == ("none", None)
    assert "--no-base-watchdog" in known.refusal
    ready.run(0.1)
    assert ready.sent_v()[-1] == 0.0


@pytest.mark.parametrize("end", [{"emergency": True}, {"motors": False}, {"lease": 0}, {"lease": 2}], ids=str)
def test_what_ends_a_drive_ends_the_measurement_with_zeros(ready, end):
    begin(ready, 0.3)
    silent = len(ready.line.sent)
    vars(ready).update(end)
    ready.run(0.2, rate_hz=100.0, v=0.1)
    assert ready.base.base_timeout.state == "unknown"
    assert ready.sent_v(silent) == [0.0] * 4


@pytest.mark.parametrize("late_s", [0.0, 0.05, 1.2])
def test_a_robot_that_a_stop_halts_is_not_measured(ready, late_s):
    """The wheels stand when the stop is pressed; the flag comes with that, or later."""
    begin(ready, 1.2)
    if late_s:
        ready.run(late_s, rate_hz=100.0, v=0.0)
        assert ready.sent_v()[-1] == 0.0  # the silence has ended all the same
    ready.emergency = True
    ready.run(0.1, rate_hz=100.0, v=0.0)
    ready.emergency = False
    ready.run(3.0)
    assert ready.base.base_timeout.state == "unknown"


def test_a_robot_that_another_publishers_zero_halts_is_not_measured(ready):
    begin(ready, 0.5)
    ready.hear("cmd_vel", twist(Velocity(0.0, 0.0)))
    assert isinstance(ready.last, Lost)
    ready.run(5.0, v=0.0)
    assert ready.base.base_timeout.state == "unknown"


def test_wheels_that_stand_or_roll_out_after_a_zero_measure_nothing(ready):
    assert ready.base.measure_base_timeout(ready.now) == "the wheels do not turn by a command"
    ready.setpoint_v = 0.1
    ready.run(0.5)
    ready.setpoint_v = 0.0
    ready.run(0.02, v=0.1, rate_hz=100.0)
    assert ready.base.measure_base_timeout(ready.now) == "the wheels do not turn by a command"


def test_a_measurement_counts_for_its_own_robot_and_not_when_it_halts_too_late(tmp_path):
    def described(name, text):
        (tmp_path / name).write_text(f"name: mine\n{text}\n")
        return load_description(tmp_path / name).measured_base_timeout_s

    turtlebot = "based_on: turtlebot4\nmeasured_base_timeout_s:"
    assert described("mine.yaml", f"{turtlebot} 0.52 # 2026-11-25") == 0.52
    assert described("other.yaml", f"based_on: {tmp_path / 'mine.yaml'}") is None
    with pytest.raises(ConfigError, match="measured_base_timeout_s"):
        described("late.yaml", f"{turtlebot} 2.6")
    assert {load_description(name).measured_base_timeout_s for name in shipped_names("robots")} == {None}


@pytest.mark.parametrize(
    ("known", "words"),
    [
        (TimeoutRecord(), "is not known to halt by itself"),
        (TimeoutRecord(0.5), "halts 0.5 s after its last command"),
        (TimeoutRecord().after(None), "does not halt by itself"),
    ],
)
def test_each_start_says_what_is_known(known, words):
    assert words in known.note
    assert words in TimeoutRecord(known.described_s, True, known.measured, known.measured_s).note


@pytest.fixture
def driver():
    """The check at a robot without a timeout behind a bridge on a virtual clock; it has begun to measure."""
    driver = DriverClient(bridge := VirtualRig(BURGER))
    bridge.sleep(3.0)
    assert driver.motors(unchecked=True).granted
    driver.drive(1.0, 0.1)
    request = dump_json(BaseRequest(measure=True, sent_ns=bridge.now_ns))
    reply = bridge.query("rover/base", request, driver.tag(Signed.MOTORS, "rover/base", request))
    assert parse_json(BaseReply, reply).state == "running"
    assert speed_after(driver, 0.7) == pytest.approx(0.1, abs=0.01)
    return driver


def speed_after(driver, seconds):
    driver.bridge.sleep(seconds)
    return driver.bridge.base.drive.measured.v


@pytest.mark.parametrize(
    ("end", "wait_s"),
    [
        (lambda driver: driver.motors(enable=False), 0.3),
        (lambda driver: driver.stop(), 0.3),
        (lambda driver: None, 0.3 + 0.3),  # the lease lasts 1 s; braking
    ],
    ids=["release", "stop", "the check died"],
)
def test_end_of_a_check_halts_a_robot_that_is_measured(driver, end, wait_s):
    end(driver)
    assert speed_after(driver, wait_s) == pytest.approx(0.0, abs=0.01)


def test_a_check_that_renews_its_lease_measures_to_the_end(driver):
    for _ in range(20):
        driver.motors(unchecked=True)
        assert speed_after(driver, 0.2) == pytest.approx(0.1, abs=0.01)
    assert speed_after(driver, 0.7) == pytest.approx(0.0, abs=0.01)
    assert driver.bridge.connection.base.base_timeout.state == "none"
