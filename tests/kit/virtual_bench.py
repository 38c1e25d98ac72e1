"""A robot and its bridge on a virtual clock, and its drivers."""

from kit.driver_client import DriverClient
from rover_ncp.wire.key_table import spec
from sim.pioneer.firmware import Firmware
from sim.pioneer.ros2_robot import Ros2Robot
from sim.stack.virtual import VirtualBridge
from sim.world.described import described_rover
from sim.world.pymunk_rover import Ground, PymunkRover

STEP_S = 0.01


class VirtualRig(VirtualBridge):
    """The bridge of one robot; each driver receives all that it publishes."""

    def __init__(self, robot, *, accept_ros=False):
        self.robot, self.rover = robot, PymunkRover(described_rover(robot), Ground(()))
        super().__init__(
            Firmware(robot, self.rover) if robot.arcos else Ros2Robot(robot, self.rover),
            accept_ros=accept_ros,
        )
        self._drivers = []

    def driver(self):
        self._drivers.append(DriverClient(self))
        return self._drivers[-1]

    def publish(self, name, data):
        for driver in self._drivers:
            driver.receive(name, data)
        super().publish(name, data)

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
