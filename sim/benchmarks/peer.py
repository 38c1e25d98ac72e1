"""A bridge without a base, for the benchmark: odometry at any rate and a lease for every request.

It executes commands at once and exactly, so that no safety rule of the driver applies. Times are those of the
system's monotonic clock, which all processes of a machine share.
"""

import math
import secrets
import time
from dataclasses import dataclass, field
from typing import Any

import zenoh

from bridge.zenoh.config import configured
from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import STANDSTILL, Pose
from rover_ncp.wire.messages import odometry, read_twist, text
from rover_ncp.wire.protocol import (
    KEY_BYTES,
    CommandTag,
    GateStatus,
    MotorsReply,
    MotorsRequest,
    dump_json,
    parse_json,
)
from sim.live.peers import Peer

STATUS_NS = 100_000_000


@dataclass
class Moments:
    """Times of events, in ns: odometry sent, commands handed over by their sender."""

    odometry: list[int] = field(default_factory=list)
    commands: list[int] = field(default_factory=list)


class BenchPeer(Peer):
    """Listens at ``robot``."""

    def __init__(self, port: int, rate_hz: float) -> None:
        self.robot = f"tcp/127.0.0.1:{port}"
        super().__init__(configured(self.robot, None, False, "cmd_vel")[0])
        self.moments = Moments()
        self._period_ns = round(1e9 / rate_hz)
        self._leases, self._driven, self._sequence = 0, False, -1
        self._velocity, self._pose = STANDSTILL, Pose(0.0, 0.0, 0.0)
        subscribe: Any = self.session.declare_subscriber
        self._declared = [
            subscribe("cmd_vel", self._command),
            self.session.declare_queryable("rover/motors", self._motors),
            self.session.liveliness().declare_token("rover/alive/bridge"),
        ]

    def run(self) -> None:
        """Send odometry and the gate's status."""
        declare: Any = self.session.declare_publisher
        odom = declare("odom", congestion_control=zenoh.CongestionControl.DROP)
        due_ns = status_ns = time.monotonic_ns()
        while not self.closing.is_set():
            time.sleep(max(due_ns - time.monotonic_ns(), 0) * 1e-9)
            payload = self._odometry(self._period_ns * 1e-9)
            self.moments.odometry.append(time.monotonic_ns())
            odom.put(payload)
            if due_ns >= status_ns:
                status_ns += STATUS_NS
                self._publish_status()
            due_ns += self._period_ns

    def _odometry(self, seconds: float) -> bytes:
        (x, y, theta), (v, omega) = self._pose, self._velocity
        middle = theta + 0.5 * omega * seconds
        x, y = x + v * seconds * math.cos(middle), y + v * seconds * math.sin(middle)
        self._pose = Pose(x, y, math.remainder(theta + omega * seconds, math.tau))
        return odometry(self._pose, self._velocity, time.time_ns())

    def _publish_status(self) -> None:
        lease = self._leases if self._driven else 0
        status = GateStatus(lease=lease, driver_name="bench" if lease else "", sequence=self._sequence)
        self.session.put("rover/gate", text(dump_json(status).decode()))

    def _command(self, sample: zenoh.Sample) -> None:
        if sample.attachment is not None:
            tag = CommandTag.unpack(sample.attachment.to_bytes())
            self.moments.commands.append(tag.stamp_ns)
            self._sequence = tag.sequence
            self._velocity = read_twist(sample.payload.to_bytes()).velocity

    def _motors(self, query: zenoh.Query) -> None:
        with query:
            try:
                request = parse_json(MotorsRequest, query.payload.to_bytes() if query.payload else b"")
            except FormatError as error:
                query.reply_err(str(error))
                return
            self._driven, self._velocity, self._sequence = request.enable, STANDSTILL, -1
            self._leases += request.enable
            grant = MotorsReply(granted=True, lease=self._leases, key=secrets.token_hex(KEY_BYTES))
            query.reply("rover/motors", dump_json(grant))
        self._publish_status()
