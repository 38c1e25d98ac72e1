"""A bridge without a base, for the benchmark: odometry at any rate, a lease for every request, and a ping.

It executes commands at once and exactly, so that no safety rule of the driver applies. Times are those of the
system's monotonic clock, which all processes of a machine share.
"""

import math
import secrets
import threading
import time
from types import TracebackType
from typing import Any, Self

import zenoh

from bridge.zenoh_config import configured
from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.core.messages import odometry, read_twist, text
from rover_ncp.core.protocol import (
    KEY_BYTES,
    CommandTag,
    GateStatus,
    MotorsReply,
    MotorsRequest,
    dump_json,
    parse_json,
)
from sim.benchmarks.echo import PING, PONG

STATUS_S = 0.1
STILL = Velocity(0.0, 0.0)


class Moments:
    """Times of events, in ns: odometry sent, commands handed over by their sender, pings and pongs."""

    def __init__(self) -> None:
        self.odometry: list[int] = []
        self.commands: list[int] = []
        self.pings: list[int] = []
        self.pongs: list[int] = []


class BenchPeer:
    """Listens at ``robot``."""

    def __init__(self, port: int) -> None:
        self.robot = f"tcp/127.0.0.1:{port}"
        settings, _ = configured(self.robot, None, False)
        self._session = zenoh.open(settings)
        self.moments = Moments()
        self._leases = 0
        self._driven = False
        self._sequence = -1
        self._velocity, self._pose = STILL, Pose(0.0, 0.0, 0.0)
        declare: Any = self._session.declare_subscriber
        self._held = [
            declare("cmd_vel", self._commanded),
            declare(PONG, lambda _: self.moments.pongs.append(time.monotonic_ns())),
            self._session.declare_queryable("rover/motors", self._asked),
            self._session.liveliness().declare_token("rover/alive/bridge"),
        ]

    def run(self, rate_hz: float, ping: bool, ended: threading.Event) -> None:
        """Send odometry at a rate until ``ended``; in the middle between two, a ping of the same size."""
        period_ns = round(1e9 / rate_hz)
        declare: Any = self._session.declare_publisher
        publish, pinged = (
            declare(name, congestion_control=zenoh.CongestionControl.DROP) for name in ("odom", PING)
        )
        due_ns = status_ns = time.monotonic_ns()
        while not ended.is_set():
            _sleep_until(due_ns)
            payload = self._odometry(period_ns * 1e-9)
            self.moments.odometry.append(time.monotonic_ns())
            publish.put(payload)
            if due_ns >= status_ns:
                status_ns += round(STATUS_S * 1e9)
                self._tell_status()
            if ping:
                _sleep_until(due_ns + period_ns // 2)
                self.moments.pings.append(time.monotonic_ns())
                pinged.put(payload)
            due_ns += period_ns
        for publisher in (publish, pinged):
            publisher.undeclare()

    def close(self) -> None:
        """End the session."""
        self._session.close()  # type: ignore[no-untyped-call]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _odometry(self, seconds: float) -> bytes:
        (x, y, theta), (v, omega) = self._pose, self._velocity
        middle = theta + 0.5 * omega * seconds
        way = v * seconds
        self._pose = Pose(
            x + way * math.cos(middle),
            y + way * math.sin(middle),
            math.remainder(theta + omega * seconds, math.tau),
        )
        return odometry(self._pose, self._velocity, time.time_ns())

    def _tell_status(self) -> None:
        lease = self._leases if self._driven else 0
        status = GateStatus(lease=lease, driver_name="bench" if lease else "", sequence=self._sequence)
        self._session.put("rover/gate", text(dump_json(status).decode()))

    def _commanded(self, sample: zenoh.Sample) -> None:
        if sample.attachment is not None:
            tag = CommandTag.unpack(sample.attachment.to_bytes())
            self.moments.commands.append(tag.stamp_ns)
            self._sequence = tag.sequence
            self._velocity = read_twist(sample.payload.to_bytes()).velocity

    def _asked(self, query: zenoh.Query) -> None:
        with query:
            try:
                assert query.payload is not None
                request = parse_json(MotorsRequest, query.payload.to_bytes())
            except FormatError as error:
                query.reply_err(str(error))
                return
            self._driven, self._velocity, self._sequence = request.enable, STILL, -1
            self._leases += request.enable
            grant = MotorsReply(granted=True, lease=self._leases, key=secrets.token_hex(KEY_BYTES))
            query.reply("rover/motors", dump_json(grant))
        self._tell_status()


def _sleep_until(moment_ns: int) -> None:
    time.sleep(max(moment_ns - time.monotonic_ns(), 0) * 1e-9)
