"""A mock Pioneer and a bridge as real processes, and a scripted driver."""

import time

from deploy.drive.lease import DriverLease
from kit.zenoh_session import open_session
from rover_ncp.core.geometry import Velocity
from rover_ncp.core.process import ClosedAtExit
from rover_ncp.wire.key_table import key
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
from sim.live.live_run import LiveRun
from sim.live.processes import wait_for

PERIOD_S = 0.05
BRAKING_M_S2, DELAY_S = 0.31, 0.15
MACHINE_S = 0.1
"""What two busy cores may add to any measured time."""


def client(locator):
    """Open a Zenoh session as a driver would."""
    settings = {"transport/link/tx/lease": 1000, "connect/timeout_ms": 2000}
    return open_session("client", {"connect/endpoints": [locator], **settings})


def zenoh_address(bridge):
    """Wait until the process of a bridge is ready; return where drivers find it."""
    return dict(part.split("=", 1) for part in bridge.wait_for_line("ready ").split())["zenoh"]


class Driver(ClosedAtExit):
    """A session with the bridge; ``send`` sends one command, ``drive`` sends them for a while."""

    def __init__(self, locator, namespace=""):
        self.session, self.namespace = client(locator), namespace
        self.lease, self.sent = DriverLease(), 0
        self.seen = {}
        self.gate, self.odom, self.out = GateStatus(), None, None
        self._subscriber = self.session.declare_subscriber(key(namespace, "odom")[:-4] + "**", self._heard)
        self._commands = self.session.declare_publisher(key(namespace, "cmd_vel"))
        wait_for(lambda: self._commands.matching_status.matching)

    def _heard(self, sample):
        name = str(sample.key_expr)
        name = name[len(self.namespace) + 1 :] if self.namespace else name
        data = sample.payload.to_bytes()
        self.seen[name] = data
        if name == "odom":
            self.odom = read_odometry(data)
        elif name == "rover/gate":
            self.gate = parse_json(GateStatus, read_text(data))
        elif name == "rover/cmd_out":
            self.out = read_twist(data).velocity

    def ask(self, name, payload, attachment=None):
        """Ask a query and return the bytes of the one answer, or the error's text."""
        where = key(self.namespace, name)
        replies = list(self.session.get(where, payload=payload, attachment=attachment, timeout=3.0))
        assert len(replies) == 1
        return replies[0].ok.payload.to_bytes() if replies[0].ok else replies[0].err.payload.to_string()

    def motors(self, enable=True):
        now_ns = time.monotonic_ns()
        payload = dump_json(MotorsRequest(enable=enable, name="test", sent_ns=now_ns))
        tag = self.lease.sign(Signed.MOTORS, key(self.namespace, "rover/motors"), payload, now_ns)
        reply = parse_json(MotorsReply, self.ask("rover/motors", payload, tag.pack()))
        self.lease.grant(reply)
        return reply

    def stop(self, release=False):
        request = StopRequest(release=release, reason="" if release else "test")
        return parse_json(StopReply, self.ask("rover/stop", dump_json(request)))

    def tag(self, payload, age_s=0.0):
        self.sent += 1
        stamp_ns = time.monotonic_ns() - round(age_s * 1e9)
        return self.lease.sign(Signed.COMMAND, key(self.namespace, "cmd_vel"), payload, stamp_ns).pack()

    def send(self, v=0.15, omega=0.0, age_s=0.0):
        """Send one command; return the wall clock's ns."""
        sent_ns = time.time_ns()
        payload = twist_stamped(Velocity(v, omega), sent_ns)
        self._commands.put(payload, attachment=self.tag(payload, age_s))
        return sent_ns

    def put(self, payload, attachment=None):
        self._commands.put(payload, attachment=attachment)

    def drive(self, seconds, v=0.15, omega=0.0):
        """Send commands for so long; return when the last one was sent, in ns."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            sent_ns = self.send(v, omega)
            time.sleep(PERIOD_S)
        return sent_ns

    def start(self, v=0.15, omega=0.0):
        """Get the motors and drive until the base reports nearly that speed."""
        wait_for(lambda: self.motors().granted)
        deadline = time.monotonic() + 5.0
        while self.odom is None or abs(self.odom.velocity.v - v) > 0.02:
            assert time.monotonic() < deadline, f"does not drive: {self.gate}"
            self.drive(PERIOD_S, v, omega)
        return self

    def close(self):
        self.session.close()


class Rig(LiveRun):
    """Mock and bridge; times of the rover's true motion are of the wall clock."""

    @property
    def locator(self):
        return self.robot

    def stood_after(self, wall_ns, still_s=0.4):
        """Wait until it has stood for ``still_s``; return how long after ``wall_ns`` it came to stand."""
        newest = self.truth.read()[-1]
        return self.truth.stood_after(wall_ns - newest.wall_ns + newest.clock_ns, 8.0, still_s)

    def speed_at(self, wall_ns):
        """Return the true speed at a moment."""
        return wait_for(lambda: next((s.velocity for s in self.truth.read() if s.wall_ns >= wall_ns), None)).v


def braking_s(v):
    """Time in s from the stop command to standstill at speed ``v``: the base's own delay, then braking."""
    return DELAY_S + abs(v) / BRAKING_M_S2
