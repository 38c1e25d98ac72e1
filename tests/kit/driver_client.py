"""A driver that a test leads step by step, at a bridge on a virtual clock or in a process of its own."""

from deploy.drive.signed_lease import DriverLease
from rover_ncp.core.geometry import Velocity
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

PERIOD_S = 0.05


class DriverClient:
    """The lease, commands and queries of one driver, and the newest of each message that it received.

    ``bridge`` has ``now_ns``, ``time_ns``, ``sleep``, ``command`` and ``query``, as a `VirtualBridge`; for
    `start` also ``wait_for``.
    """

    name = "test"

    def __init__(self, bridge, namespace=""):
        self.bridge, self.lease, self.sent, self.seen = bridge, DriverLease(), 0, {}
        self.prefix = namespace and f"{namespace}/"
        self.gate, self.odom, self.out = GateStatus(), None, None

    def receive(self, name, data):
        self.seen[name] = data
        if name == "odom":
            self.odom = read_odometry(data)
        elif name == "rover/gate":
            self.gate = parse_json(GateStatus, read_text(data))
        elif name == "rover/cmd_out":
            self.out = read_twist(data).velocity

    def tag(self, kind, name, payload, age_s=0.0):
        """Sign a message; return its attachment."""
        stamp_ns = self.bridge.now_ns - round(age_s * 1e9)
        return self.lease.sign(kind, self.prefix + name, payload, stamp_ns).pack()

    def motors(self, enable=True):
        """Request, renew or release the lease."""
        request = MotorsRequest(enable=enable, name=self.name, sent_ns=self.bridge.now_ns)
        payload = dump_json(request)
        tag = self.tag(Signed.MOTORS, "rover/motors", payload) if self.lease.number else None
        reply = parse_json(MotorsReply, self.bridge.query("rover/motors", payload, tag))
        self.lease.grant(reply)
        if not enable:
            self.lease.end()
        return reply

    def stop(self, release=False):
        request = StopRequest(release=release, reason="" if release else self.name)
        return parse_json(StopReply, self.bridge.query("rover/stop", dump_json(request)))

    def put(self, payload, age_s=0.0):
        """Send a command with any payload."""
        self.sent += 1
        self.bridge.command(payload, self.tag(Signed.COMMAND, "cmd_vel", payload, age_s))

    def send(self, v=0.15, omega=0.0, age_s=0.0):
        """Send one command; return when, in ns of the monotonic clock."""
        sent_ns = self.bridge.now_ns
        self.put(twist_stamped(Velocity(v, omega), self.bridge.time_ns()), age_s)
        return sent_ns

    def drive(self, seconds, v=0.15, omega=0.0):
        """Send commands for so long; return when the last one was sent, as `send`."""
        for _ in range(max(round(seconds / PERIOD_S), 1)):
            sent_ns = self.send(v, omega)
            self.bridge.sleep(PERIOD_S)
        return sent_ns

    def start(self, v=0.15, omega=0.0):
        """Get the motors and drive until the base reports nearly that speed."""
        self.bridge.wait_for(lambda: self.motors().granted)

        def drives():
            if not self.gate.lease:  # a stall of the computer ended it
                self.motors()
            self.drive(PERIOD_S, v, omega)
            return self.odom is not None and abs(self.odom.velocity.v - v) <= 0.02

        self.bridge.wait_for(drives)
        return self
