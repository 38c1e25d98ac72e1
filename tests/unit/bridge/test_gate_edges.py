"""The gate: the exact place of each bound, and frozen odometry."""

import math

import pytest
from gate_bench import LIMITS, SLOW, Gate

from bridge.base import BaseReport
from bridge.gate.limits import Limits
from bridge.gate.state import ZERO, BaseLost, Reason, Tick, VelocityCommand
from rover_ncp.wire.protocol import CommandTag

# A pose that stands still


@pytest.mark.parametrize("motion", [{"v": 0.05}, {"v": -0.05}, {"omega": 0.1}, {"omega": -0.1}])
def test_frozen_odometry_ends_the_lease(motion):
    gate = Gate().driving()
    gate.at(0.1, BaseReport(x=1.0, **motion))
    assert gate.at(0.2, BaseReport(x=1.0, **motion)).held is None
    verdict = gate.at(0.31, BaseReport(x=1.0, **motion))
    assert (verdict.velocity, verdict.held) == (ZERO, Reason.FROZEN)
    assert gate.state.lease_over is Reason.FROZEN
    assert gate.enable(0.35).refusal is Reason.FROZEN
    gate.at(0.4, BaseReport(x=1.001))
    assert gate.enable(0.45).refusal is None


@pytest.mark.parametrize("steps", [{"x": 0.001}, {"y": 0.001}, {"theta": 0.0015}])
def test_one_changed_count_is_no_frozen_odometry(steps):
    gate = Gate().driving()
    for k in range(1, 40):
        pose = {name: (k // 2) * step for name, step in steps.items()}
        gate.at(0.1 * k, BaseReport(v=0.09, omega=0.19, **pose))
        assert gate.drive(0.1 * k).held is None


def test_frozen_distance_uses_the_slower_of_two_reports():
    gate = Gate().driving()
    for k in range(1, 40):
        fast = 0.3 * (k % 2)
        gate.at(0.1 * k, BaseReport(v=fast, omega=fast))
        assert gate.drive(0.1 * k).held is None


@pytest.mark.parametrize(("motion", "frozen"), [({"v": 0.01}, True), ({"omega": 0.02}, True), ({}, False)])
def test_odometry_is_frozen_from_exactly_this_distance_on(motion, frozen):
    gate = Gate().driving()
    gate.at(1.0, BaseReport(x=1.0, **motion))
    gate.at(1.5, BaseReport(x=1.0, **motion))
    assert (gate.at(2.0, BaseReport(x=1.0, **motion)).held is Reason.FROZEN) is frozen


@pytest.mark.parametrize(("speed", "frozen"), [(0.009, False), (0.01, True)])
@pytest.mark.parametrize("name", ["v", "omega"])
def test_noisy_speed_of_a_robot_that_stands_is_no_frozen_odometry(name, speed, frozen):
    # Wheels give the pose and an IMU the speed: the pose would not change before the robot may drive.
    gate = Gate()
    for k in range(100):
        gate.at(0.1 * k, BaseReport(x=1.0, **{name: speed}))
    assert (gate.enable(10.0).refusal is Reason.FROZEN) is frozen


@pytest.mark.parametrize("name", ["v", "omega"])
def test_speed_that_changes_its_sign_is_no_frozen_odometry(name):
    # Motors that hold a robot on a slope flicker by a tick of its encoders.
    gate = Gate()
    for k in range(100):
        gate.at(0.1 * k, BaseReport(x=1.0, **{name: 0.014 if k % 4 < 2 else -0.014}))
    assert gate.enable(10.0).refusal is None


@pytest.mark.parametrize("motion", [{"v": 0.3}, {"omega": 0.6}])
def test_noisy_odometry_may_repeat_a_pose_once(motion):
    gate = Gate().driving()
    gate.at(0.1, BaseReport(x=1.0, **motion))
    assert gate.at(0.2, BaseReport(x=1.0, **motion)).held is None
    # By chance again, and counted anew.
    gate.at(0.21, BaseReport(x=1.01, **motion))
    assert gate.at(0.25, BaseReport(x=1.01, **motion)).held is None
    assert gate.at(0.29, BaseReport(x=1.01, **motion)).held is Reason.FROZEN


@pytest.mark.parametrize("motion", [{"v": 0.05}, {"omega": 0.1}])
def test_reconnected_base_has_no_frozen_odometry(motion):
    gate = Gate()
    for moment in (0.0, 0.1, 0.2):
        gate.at(moment, BaseReport(x=1.0, **motion))
    assert gate.at(0.25, BaseReport(x=1.0, **motion)).held is Reason.FROZEN
    gate.at(0.3, BaseLost())
    gate.at(0.4, BaseReport(x=1.0, **motion))
    assert gate.at(0.5, BaseReport(x=1.0, **motion)).held is Reason.NO_LEASE


# Who may drive


def test_plain_commands_are_dropped_unless_allowed():
    gate = Gate()
    gate.at(0.0, BaseReport())
    assert gate.at(0.1, VelocityCommand(SLOW)).dropped is Reason.FOREIGN
    assert gate.state.lease is None
    assert gate.at(0.2, BaseReport()).velocity == ZERO


def test_renewal_clears_command_and_hold_reason():
    gate = Gate().driving()
    verdict = gate.renew(0.1)
    assert (verdict.velocity, verdict.held) == (ZERO, Reason.SILENCE)
    assert gate.drive(0.15, None).held is Reason.UNREADABLE
    assert gate.renew(0.2).held is Reason.SILENCE


def test_a_new_request_clears_the_reason_of_the_last_end():
    gate = Gate().driving()
    gate.at(0.1, BaseReport(bumpers=(1, 0)))
    gate.at(0.2, BaseReport())
    assert gate.state.lease_over is Reason.BUMPER
    gate.enable(0.3)
    assert gate.state.lease_over is None


def test_invalid_command_uses_its_sequence_number():
    gate = Gate().driving()
    gate.drive(0.1, None, sequence=50)
    assert gate.drive(0.1, sequence=50).dropped is Reason.REPEATED


# To the last bit


def after(moment):
    return math.nextafter(moment, math.inf)


def test_odometry_is_stale_after_exactly_this_time():
    gate = Gate(Limits(command_timeout_s=0.4)).driving()
    assert gate.at(LIMITS.odometry_s, Tick()).held is None
    assert gate.at(after(LIMITS.odometry_s), Tick()).held is Reason.ODOMETRY


def test_lease_expires_after_exactly_this_time():
    gate = Gate().driving()
    gate.at(LIMITS.lease_s, Tick())
    assert gate.state.lease is not None
    gate.at(after(LIMITS.lease_s), Tick())
    assert gate.state.lease is None


def test_command_is_stale_beyond_exactly_this_age():
    gate = Gate(Limits(stale_s=0.25), ahead_s=0.0)
    gate.at(0.0, BaseReport())
    gate.enable(0.0)
    assert gate.drive(0.25, age=0.25).dropped is None
    assert gate.at(0.25, VelocityCommand(SLOW, CommandTag(1, 9, -1), signed=True)).dropped is Reason.STALE


@pytest.mark.parametrize("age_s", [0.3, -0.3])
def test_plain_command_of_exactly_the_allowed_age_is_accepted(age_s):
    gate = Gate(accept_ros=True)
    gate.at(0.0, BaseReport())
    assert gate.at(0.1, VelocityCommand(SLOW, age_s=age_s)).dropped is None


def test_plain_commands_are_accepted_after_exactly_this_pause():
    gate = Gate(accept_ros=True)
    gate.at(1.0, BaseReport())
    gate.at(1.0, VelocityCommand(SLOW))
    gate.at(1.0, BaseReport(bumpers=(1, 0)))
    gate.at(1.9, BaseReport())
    assert gate.at(math.nextafter(2.0, 0.0), VelocityCommand(SLOW)).dropped is Reason.NO_LEASE
    assert gate.at(2.9, BaseReport()).held is Reason.NO_LEASE
    assert gate.at(math.nextafter(3.0, 0.0), VelocityCommand(ZERO, age_s=1.0)).dropped is Reason.STALE
    assert gate.at(3.0, VelocityCommand(SLOW)).dropped is None


@pytest.mark.parametrize("motion", [{"v": 0.01}, {"v": -0.01}, {"omega": 0.01}])
def test_motors_of_a_moving_rover_go_off_after_exactly_this_time(motion):
    gate = Gate().driving(1.0)
    gate.at(1.0, BaseReport(**motion))
    gate.release(1.0)
    assert gate.at(math.nextafter(3.0, 0.0), Tick()).motors
    assert not gate.at(3.0, Tick()).motors


def test_motors_go_off_below_exactly_this_speed():
    gate = Gate().driving(1.0)
    slow = math.nextafter(0.01, 0.0)
    gate.at(1.0, BaseReport(v=slow, omega=-slow))
    assert not gate.release(1.0).motors


def test_half_a_volt_is_low():
    gate = Gate().driving()
    for k in range(21):
        gate.at(0.1 * k, BaseReport(battery_v=0.5))
    assert gate.at(2.0, BaseReport(battery_v=0.5)).held is Reason.LOW_BATTERY


def test_reconnected_base_has_time_to_recover_its_voltage():
    gate = Gate()
    gate.at(0.0, BaseReport(battery_v=10.0))
    gate.at(1.5, BaseLost())
    gate.at(1.6, BaseReport(battery_v=10.0))
    assert gate.at(3.0, BaseReport(battery_v=10.0)).held is Reason.NO_LEASE
    assert gate.at(3.6, BaseReport(battery_v=10.0)).held is Reason.LOW_BATTERY


@pytest.mark.parametrize(("after_s", "dropped"), [(60.5, Reason.STALE), (61.5, None)])
def test_smallest_delay_is_kept_for_whole_seconds(after_s, dropped):
    begun = 1000.0
    gate = Gate().driving(begun)
    for k in range(1, round(after_s * 4)):
        gate.at(begun + 0.25 * k, BaseReport())
        gate.drive(begun + 0.25 * k, age=0.15)
    gate.at(begun + after_s, BaseReport())
    assert gate.drive(begun + after_s, age=0.3).dropped is dropped


def test_one_minimum_is_kept_for_each_second():
    gate = Gate().driving()
    for k in range(100):
        gate.at(0.05 * k, BaseReport())
        gate.drive(0.05 * k)
    assert len(gate.state.minima) <= 6


def test_creeping_base_is_no_frozen_odometry():
    gate = Gate().driving(1000.0)
    for k in range(1, 20):
        gate.at(1000.0 + 0.1 * k, BaseReport(x=1.0, v=0.001))
        assert gate.drive(1000.0 + 0.1 * k).held is None
