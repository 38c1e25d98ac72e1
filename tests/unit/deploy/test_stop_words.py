"""Who stopped a driver and why, in its own message: bridge, gate and monitor on a virtual clock."""

import pytest

from bridge.base import Lost
from deploy.drive.measurements import Measurements
from deploy.drive.safety_monitor import SafetyMonitor
from rover_ncp.core.errors import SafetyStop
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.wire.protocol import StopRequest, dump_json
from sim.pioneer.firmware import Firmware
from sim.stack.virtual import VirtualBridge, VirtualLink
from sim.world.described import default_rover
from sim.world.pymunk_rover import Ground, PymunkRover


class Driven:
    """A driver that holds the lease of a bridge, and drives."""

    def __init__(self):
        self.bridge = VirtualBridge(Firmware("p3at-sh", PymunkRover(default_rover(), Ground(()))))
        self.bridge.sleep(3.0)
        self.link = VirtualLink(self.bridge, Pose(0.0, 0.0, 0.0))
        self.bridge.sleep(0.2)
        self.measurements = Measurements(self.link)
        self.monitor = SafetyMonitor(self.link, self.measurements, lambda: False, clock=self.bridge)
        self.monitor.wait()
        self.link.request_motors("test")
        self.monitor.granted()
        self.drive(0.5)

    def drive(self, seconds, commands=True):
        for _ in range(round(seconds / 0.05)):
            if commands:
                self.link.command(Velocity(0.1, 0.0))
            self.bridge.sleep(0.05)
            self.measurements.odometry(0)
            self.monitor.check()

    def request_stop(self, **fields):
        self.bridge.query("rover/stop", dump_json(StopRequest(**fields)))

    def words(self):
        """Drive on; return the words of the stop."""
        with pytest.raises(SafetyStop) as stop:
            self.drive(1.0)
        return str(stop.value)


@pytest.mark.parametrize(
    ("request_", "expected"),
    [
        ({"reason": "the live page's Stop button"}, "stopped by the live page's Stop button"),
        ({"reason": "Anna: smoke"}, "stopped by Anna: smoke"),
        ({}, "stopped by a client that gave no name"),
    ],
)
def test_a_requested_stop_names_who_requested_it(request_, expected):
    driven = Driven()
    driven.request_stop(**request_)
    assert driven.words() == expected


def test_a_stop_that_is_released_at_once_keeps_its_name():
    driven = Driven()
    driven.request_stop(reason="Anna")
    driven.request_stop(release=True)
    assert driven.words() == "stopped by Anna"


@pytest.mark.parametrize("reason", ["/teleop publishes /cmd_vel too", "ü" * 1000])
def test_a_lost_base_is_named_as_the_bridge_knows_it(reason):
    driven = Driven()
    driven.bridge._node._handle([Lost(reason)], driven.bridge.monotonic())
    assert driven.words().startswith(f"stopped by no-base: the base is not connected: {reason}"[:200])
    with pytest.raises(SafetyStop, match=f"the base is not connected: {reason[:30]}"):
        driven.link.request_motors("again")


def test_a_lease_that_lapsed_has_words():
    driven = Driven()
    with pytest.raises(SafetyStop) as stop:
        driven.drive(1.5, commands=False)
    assert str(stop.value) == "stopped by lease-lapsed: no command arrived for longer than a lease lasts"
