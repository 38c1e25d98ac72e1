"""The bridge's loop with gate, session and mock base, on a virtual clock."""

import logging
import math

import pytest
from kit.ros2_world import BURGER
from kit.virtual_bench import VirtualDriver, VirtualRig

from bridge.gate.limits import Fence, Limits
from bridge.pioneer.connection import Received
from bridge.pioneer.framing import Command, Decoder
from rover_ncp.core.geometry import Velocity
from rover_ncp.course.course import Obstacle
from rover_ncp.robot.description import load_description
from rover_ncp.wire.cdr import decode
from sim.base.client_commands import decode_argument
from sim.base.faults import parse_fault
from sim.stack.virtual import WALL_NS

HOUR_NS = 3600 * 1_000_000_000
SECOND_NS = 1_000_000_000


class Bridge(VirtualRig):
    """A bridge whose wall clock can be set, with its driver, its setpoints and what it sent to the base."""

    set_ns = 0
    slept_s = 0.0
    enables = 0
    """Number of ENABLE 1."""

    def __init__(self, limits=None):
        self.stamps, self.published, self.sent = [], [], []
        self._decoder = Decoder()
        super().__init__(load_description("p3at-sh"), limits=limits)
        self.driver = VirtualDriver(self)
        self.connection.write, self._write = self.write, self.connection.write
        self.sleep(3.0)
        assert abs(self.stamps[-1]) < SECOND_NS / 10

    def time_ns(self):
        return super().time_ns() + self.set_ns

    def suspended_s(self):
        return self.slept_s

    def publish(self, name, data):
        super().publish(name, data)
        if name == "odom":
            self.stamps.append(self.driver.odom.stamp_ns - WALL_NS - self.now_ns)
        if name == "rover/cmd_out":
            self.published.append(self.driver.out)

    def write(self, data):
        for packet in self._decoder.feed(data, self.monotonic()):
            if packet.kind in {Command.VEL, Command.RVEL}:
                self.sent.append((Command(packet.kind), decode_argument(packet.kind, packet.payload)))
            elif packet.kind == Command.ENABLE:
                self.enables += decode_argument(packet.kind, packet.payload)
        self._write(data)


@pytest.fixture
def bridge():
    """A bridge whose driver has the lease."""
    bridge = Bridge()
    assert bridge.driver.motors().granted
    return bridge


@pytest.mark.parametrize("step_ns", [HOUR_NS, -HOUR_NS])
def test_stamps_do_not_step_during_a_lease_and_are_right_again_after_it(bridge, step_ns):
    bridge.set_ns = step_ns
    del bridge.stamps[:]
    bridge.sleep(0.8)
    assert len(bridge.stamps) >= 7
    assert all(abs(stamp) < SECOND_NS / 10 for stamp in bridge.stamps)
    bridge.sleep(1.8)  # the lease lapses: no command arrives
    assert abs(bridge.stamps[-1] - step_ns) < SECOND_NS / 10


def test_after_a_suspend_no_command_from_before_it_reaches_the_base(bridge):
    """The monotonic clock stood still, so by it the last command is fresh and the lease valid."""
    bridge.driver.drive(1.0, 0.2)
    assert bridge.sent[-2:] == [(Command.VEL, 200), (Command.RVEL, 0)]
    bridge.sent.clear()
    bridge.slept_s = 3.0
    bridge.driver.drive(1.0, 0.2)
    assert {value for _, value in bridge.sent} == {0}
    bridge.driver.lease.end()
    bridge.driver.motors()
    bridge.driver.drive(1.0, 0.2)
    assert (Command.VEL, 200) in bridge.sent


def test_base_gets_the_published_setpoint_rounded_to_its_units(bridge):
    """The gate has the last word: its output is published, and only rounding changes it."""
    wanted = Velocity(9.0, -0.0567)
    for _ in range(60):
        bridge.published.clear()
        bridge.sent.clear()
        bridge.driver.drive(0.1, *wanted)
        for command, value in bridge.sent:
            factor, axis, step = (1000.0, 0, 0.5) if command is Command.VEL else (math.degrees(1.0), 1, 1.0)
            passed = [velocity[axis] * factor for velocity in bridge.published]
            assert min(passed) - step <= value <= max(passed) + step
    assert bridge.published[-1] == (0.3, -0.0567)


def test_a_damaged_packet_is_a_warning_for_some_seconds(bridge):
    levels = []
    bridge.deliver = lambda name, data: (
        name != "diagnostics"
        or levels.append(decode("diagnostic_msgs/msg/DiagnosticArray", data).status[0].level)
    )
    bridge.sleep(2.0)
    bridge.connection.arrivals.append(Received(bytes.fromhex("fafb0632010203ffff")))
    bridge.sleep(15.0)
    assert (levels[0], max(levels), levels[-1]) == (0, 1, 0)


# The motors


def test_new_lease_enables_the_motors_of_a_rover_that_still_rolls_after_the_stop_button(bridge):
    driver = bridge.driver
    driver.drive(1.0, 0.3)
    bridge.base.inject(parse_fault("stop-button@0-0.12"))
    bridge.sleep(0.2)
    assert driver.gate.ended == "stop-button"
    assert driver.odom.velocity.v > 0.05  # so the gate has not switched the motors off yet
    driver.lease.end()
    driver.motors()
    driver.drive(2.0, 0.2)
    assert (driver.gate.lease, driver.gate.held) == (driver.lease.number, "")
    assert driver.odom.velocity.v == pytest.approx(0.2, abs=0.02)


def test_each_new_lease_enables_the_motors_and_a_renewal_does_not():
    driver = (bridge := Bridge()).driver
    for number in (1, 2, 3):
        for _ in range(2):
            driver.motors()
            driver.drive(1.0, 0.2)
            assert driver.lease.number == bridge.enables == number
        driver.motors(enable=False)
        bridge.sleep(3.0)


# A fence


FENCED = Limits(fence=Fence(x_min=-1.0, x_max=1.0, y_min=-1.0, y_max=1.0))


def test_fence_is_lost_when_the_base_is_connected_again():
    driver = (bridge := Bridge(FENCED)).driver
    driver.motors()
    driver.drive(3.0, 0.3)
    driver.motors(enable=False)
    bridge.sleep(3.0)
    assert driver.odom.pose.x > 0.5
    bridge.base.inject(parse_fault("reset@0-0.1"))
    bridge.sleep(12.0)
    assert abs(driver.odom.pose.x) < 0.01
    for _ in range(2):
        reply = driver.motors()
        assert (reply.granted, reply.reason, driver.gate.held) == (False, "fence-lost", "fence-lost")
        assert "restart the bridge" in reply.detail
        bridge.sleep(5.0)


# Bases that misbehave or meet a wall


RECOVERY_S = 5.0


@pytest.mark.parametrize(("silent_s", "reopened"), [(1.0, 0), (4.0, 1)])  # after 2.3 s
def test_a_base_that_falls_silent_is_there_again_soon_after(silent_s, reopened, caplog):
    caplog.set_level(logging.INFO, "rover_ncp")
    driver = VirtualDriver(rig := VirtualRig(load_description("p3at")))
    driver.start()
    for name in ("mute", "deaf"):
        rig.base.inject(parse_fault(f"{name}@0-{silent_s}"))
    began_s = rig.monotonic()
    rig.wait_for(lambda: driver.gate.held == "no-base")
    assert driver.motors().reason == "no-base"
    rig.wait_for(lambda: driver.gate.held != "no-base", silent_s + RECOVERY_S)
    assert silent_s < rig.monotonic() - began_s < silent_s + RECOVERY_S
    # The log says so once, however long it lasts; the rover stands until a driver asks again.
    lines = [line for line in caplog.messages if "reopens the line" in line]
    assert len(lines) == rig._node.reconnects == reopened
    assert all(line.startswith("virtual: no packet from the base since it was lost; ") for line in lines)
    rig.sleep(0.6)  # it brakes
    driver.drive(0.3)
    assert (driver.gate.lease, rig.rover.velocity.v) == (0, 0.0)
    driver.start()
    assert not (rig.base.unknown or rig.base.bad_arguments or rig.base.decoder.bad_checksums)


def test_a_wall_in_its_scan_stops_a_ros2_robot_and_the_way_back_is_free():
    wall = Obstacle(x=1.05, y=0.0, length=0.1, width=2.0)
    driver = VirtualDriver(
        rig := VirtualRig(BURGER, limits=Limits(v_max=0.22, sonar_stop_m=0.3), walls=[wall])
    )
    driver.start(v=0.2)
    rig.wait_for(lambda: driver.drive(0.1, v=0.2) and driver.gate.held == "sonar")
    assert rig.stands_after(0.5)
    # The wall begins at 1 m, the outline 0.041 m before the centre; a scan is 0.2 s old at most.
    left_m = 1.0 - 0.041 - rig.rover.pose.x
    assert 0.3 - 0.2 * (0.2 + 0.05 + 0.08) - 0.22**2 / 2 / 2.5 < left_m < 0.3
    driver.drive(1.0, v=-0.1)
    assert driver.odom.velocity.v == pytest.approx(-0.1, abs=0.02)
