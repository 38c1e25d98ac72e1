"""A robot and its bridge on a virtual clock, and its drivers."""

from kit.driver_client import DriverClient
from rover_ncp.wire.key_table import spec
from sim.base.firmware import Firmware
from sim.base.ros2_robot import Ros2Robot
from sim.stack.virtual import VirtualBridge
from sim.world.described import described_rover
from sim.world.pymunk_rover import Ground, PymunkRover

STEP_S = 0.01


class VirtualRig(VirtualBridge):
    """The bridge of one robot; each driver receives all that it publishes."""

    def __init__(self, robot, *, limits=None):
        self.rover = PymunkRover(described_rover(robot), Ground(()))
        self.base = Firmware(robot, self.rover) if robot.arcos else Ros2Robot(robot, self.rover)
        super().__init__(self.base, limits)
        self.drivers = []

    def publish(self, name, data):
        super().publish(name, data)
        for driver in self.drivers:
            driver.receive(name, data)

    def wait_for(self, condition, seconds=10.0):
        """Let time pass until ``condition`` holds; return its value."""
        end_ns = self.now_ns + round(seconds * 1e9)
        while not (found := condition()):
            assert self.now_ns < end_ns, "timed out on the virtual clock"
            self.sleep(STEP_S)
        return found

    # As from Zenoh, only the first bytes of a message that is too long arrive.

    def command(self, data, attachment=None):
        super().command(data[: spec("cmd_vel").max_bytes + 1], attachment)

    def query(self, name, payload, attachment=None):
        return super().query(name, payload[: spec(name).max_bytes + 1], attachment)

    def stands_after(self, seconds):
        """Let that time pass; return whether the rover then stands still for 0.4 s."""
        self.sleep(seconds)
        speeds = []
        for _ in range(40):
            speeds.append(max(map(abs, self.rover.velocity)))
            self.sleep(STEP_S)
        return max(speeds) < 1e-3


class VirtualDriver(DriverClient):
    """A driver of a `VirtualRig`."""

    def __init__(self, rig):
        super().__init__(rig)
        self.rig = rig
        rig.drivers.append(self)
