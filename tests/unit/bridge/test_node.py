"""The bridge's loop with gate, session and mock base, on a virtual clock."""

import math

import pytest
from kit.virtual_bench import VirtualDriver, VirtualRig

from bridge.pioneer.framing import Command, Decoder
from rover_ncp.robot.description import load_description
from sim.base.client_commands import decode_argument
from sim.base.faults import parse_fault
from sim.stack.virtual import WALL_NS

HOUR_NS = 3600 * 1_000_000_000
SECOND_NS = 1_000_000_000


class Bridge(VirtualRig):
    """A bridge whose wall clock can be set, with its driver and the setpoints that it sent to the base."""

    set_ns = 0
    slept_s = 0.0

    def __init__(self):
        self.stamps, self.sent = [], []
        self._decoder = Decoder()
        super().__init__(load_description("p3at-sh"))
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

    def write(self, data):
        for packet in self._decoder.feed(data, self.monotonic()):
            if packet.kind in {Command.VEL, Command.RVEL}:
                self.sent.append((Command(packet.kind), decode_argument(packet.kind, packet.payload)))
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


@pytest.mark.parametrize("fault", ["corrupt=0.15", "drop=0.15", "noise=0.2"])
def test_a_bad_line_is_survived_both_ways(fault):
    """Invariant: the pose stays the base's, speeds stay as commanded, and the end is a standstill."""
    rig = VirtualRig(load_description("p3at-sh"))
    driver = VirtualDriver(rig).start()
    rig.base.inject(parse_fault(f"{fault}@0-20"))
    for _ in range(100):
        driver.drive(0.1, 0.15, 0.1)
        assert abs(rig.rover.target.v) < 0.1501
        odometry, seen = rig.base.drive.odometry, driver.odom.pose
        assert math.dist(odometry[:2], seen[:2]) < 0.15 * 0.6 + 0.003
        if rig._node.report is None:
            break
    assert driver.odom.pose.x > 0.2
    assert rig.base.decoder.bad_checksums + rig.base.decoder.skipped_bytes > 0 or "drop" in fault
    driver.motors(enable=False)
    assert rig.stands_after(5.0)
