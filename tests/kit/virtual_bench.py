"""A robot and its bridge on a virtual clock, with scripted drivers as those of `bridge_bench`."""

from bridge.inbox import CommandMessage, Query
from deploy.drive.lease import DriverLease
from kit.bridge_bench import PERIOD_S
from rover_ncp.core.geometry import Velocity
from rover_ncp.wire.key_table import spec
from rover_ncp.wire.messages import read_odometry, read_text, read_twist, twist_stamped
from rover_ncp.wire.protocol import (
    GateStatus,
    MotorsReply,
    MotorsRequest,
    Signed,
    StopReply,
    StopRequest,
    dump_json,
    parse_json,
)
from sim.pioneer.firmware import Firmware
from sim.pioneer.ros2_robot import Ros2Robot
from sim.stack.virtual import VirtualBridge
from sim.world.described import described_rover
from sim.world.pymunk_rover import Ground, PymunkRover

STEP_S = 0.01


class VirtualRig(VirtualBridge):
    """The bridge of one robot among ``walls``; each driver receives all that it publishes."""

    def __init__(self, robot, *, accept_ros=False, limits=None, walls=(), firmware=Firmware):
        self.rover = PymunkRover(described_rover(robot), Ground(walls))
        self.base = firmware(robot, self.rover) if robot.arcos else Ros2Robot(robot, self.rover)
        super().__init__(self.base, limits, accept_ros=accept_ros)
        self.drivers = []
        self.deliver = self._deliver

    def _deliver(self, name, data):
        for driver in self.drivers:
            driver.receive(name, data)

    def wait_for(self, condition, seconds=10.0):
        """Let time pass until ``condition`` holds; return its value."""
        end_ns = self.now_ns + round(seconds * 1e9)
        while not (found := condition()):
            assert self.now_ns < end_ns, "timed out on the virtual clock"
            self.sleep(STEP_S)
        return found

    def stands_after(self, seconds):
        """Let that time pass; return whether the rover then stands still for 0.4 s."""
        self.sleep(seconds)
        speeds = []
        for _ in range(40):
            speeds.append(max(map(abs, self.rover.velocity)))
            self.sleep(STEP_S)
        return max(speeds) < 1e-3


class VirtualDriver:
    """A driver of a `VirtualRig`."""

    def __init__(self, rig):
        self.rig, self.lease, self.sent, self.seen = rig, DriverLease(), 0, {}
        self.gate, self.odom, self.out = GateStatus(), None, None
        rig.drivers.append(self)

    def receive(self, name, data):
        self.seen[name] = data
        if name == "odom":
            self.odom = read_odometry(data)
        elif name == "rover/gate":
            self.gate = parse_json(GateStatus, read_text(data))
        elif name == "rover/cmd_out":
            self.out = read_twist(data).velocity

    def ask(self, name, payload, attachment=None):
        """Ask a query and return the bytes of the answer, or the error's text."""
        answers = []
        payload = payload[: spec(name).max_bytes + 1]
        self.rig._inbox.append(Query(name, payload, attachment, answers.append, answers.append))
        self.rig._run_node()
        (answer,) = answers
        return answer

    def motors(self, enable=True):
        payload = dump_json(MotorsRequest(enable=enable, name="test", sent_ns=self.rig.now_ns))
        tag = self.lease.sign(Signed.MOTORS, "rover/motors", payload, self.rig.now_ns)
        reply = parse_json(MotorsReply, self.ask("rover/motors", payload, tag.pack()))
        self.lease.grant(reply)
        return reply

    def stop(self, release=False):
        request = StopRequest(release=release, reason="" if release else "test")
        return parse_json(StopReply, self.ask("rover/stop", dump_json(request)))

    def tag(self, payload, age_s=0.0):
        self.sent += 1
        stamp_ns = self.rig.now_ns - round(age_s * 1e9)
        return self.lease.sign(Signed.COMMAND, "cmd_vel", payload, stamp_ns).pack()

    def send(self, v=0.15, omega=0.0, age_s=0.0):
        payload = twist_stamped(Velocity(v, omega), self.rig.time_ns())
        self.put(payload, self.tag(payload, age_s))

    def put(self, payload, attachment=None):
        """Send a message; as from Zenoh, only the first bytes of one that is too long arrive."""
        payload = payload[: spec("cmd_vel").max_bytes + 1]
        self.rig._inbox.append(CommandMessage(payload, attachment))

    def drive(self, seconds, v=0.15, omega=0.0):
        """Send commands for that long."""
        for _ in range(round(seconds / PERIOD_S)):
            self.send(v, omega)
            self.rig.sleep(PERIOD_S)

    def start(self, v=0.15, omega=0.0):
        """Get the motors and drive until the base reports nearly that speed."""
        self.rig.wait_for(lambda: self.motors().granted)
        for _ in range(100):
            if self.odom is not None and abs(self.odom.velocity.v - v) <= 0.02:
                return self
            self.drive(PERIOD_S, v, omega)
        raise AssertionError(f"does not drive: {self.gate}")
