"""Scripted driver: drives at constant speed, and can send the messages of a hostile or broken driver.

It uses the protocol of ``rover-ncp deploy``. Without a lease it requests one again, and it sends commands in
every state of the gate. So the gate stops the rover, never the driver.
"""

import time
from contextlib import suppress

import zenoh

from deploy.drive.lease import DriverLease
from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import Velocity
from rover_ncp.wire.messages import read_odometry, read_text, twist_stamped
from rover_ncp.wire.protocol import (
    GateStatus,
    MotorsReply,
    MotorsRequest,
    Signed,
    StopRequest,
    dump_json,
    parse_json,
)
from rover_ncp.wire.zenoh import client_config
from sim.live.peers import Peer

PERIOD_S = 0.05
REQUEST_S = 0.25
STOP_TIMEOUT_S = 2.0
NAME = "hand"
"""The driver's name in the gate's status, and of a soak's JSON."""


class ScriptedDriver(Peer):
    """Drives at ``velocity``; ``lease_s`` is the Zenoh lease, the time for which the link may be silent."""

    def __init__(self, robot: str, lease_s: float = 1.0) -> None:
        config, _ = client_config(robot, None)
        config.insert_json5("transport/link/tx/lease", str(round(lease_s * 1000)))
        super().__init__(config)
        self.lease = DriverLease()
        self.velocity = Velocity(0.0, 0.0)
        self.payload: bytes | None = None
        """Sent instead of the velocity, if not None."""
        self.requests_lease = True
        """Whether it requests the lease when it has none."""
        self.silent = False
        self.age_s = 0.0
        """How much older each command's stamp is than its true time, in s."""
        self.gate = GateStatus()
        self.last_sent_ns = 0
        """When the last command was sent, in ns of the monotonic clock."""
        self.odometry_ns: list[int] = []
        """The stamps of all odometry."""
        self._requested_s = 0.0
        self._subscribers = [
            self.session.declare_subscriber("odom", self._odometry),
            self.session.declare_subscriber("rover/gate", self._gate),
        ]

    @property
    def driving(self) -> bool:
        """Whether the gate granted the lease to this driver."""
        return 0 < self.lease.number == self.gate.lease

    def send(self, payload: bytes) -> None:
        """Send one command with any payload."""
        stamp_ns = time.monotonic_ns() - round(self.age_s * 1e9)
        tag = self.lease.sign(Signed.COMMAND, "cmd_vel", payload, stamp_ns)
        self.session.put("cmd_vel", payload, attachment=tag.pack())

    def stop(self, release: bool = False) -> bool:
        """Request a stop, or its release; return whether the bridge answers."""
        request = StopRequest(release=release, reason="" if release else NAME)
        replies = self.session.get("rover/stop", payload=dump_json(request), timeout=STOP_TIMEOUT_S)
        return any(reply.ok is not None for reply in replies)

    def run(self) -> None:
        """Request the lease and send commands, without releasing the lease in the end."""
        while not self.closing.wait(PERIOD_S):
            now = time.monotonic()
            if self.requests_lease and not self.driving and now - self._requested_s > REQUEST_S:
                self._requested_s = now
                self._request_lease()
            if not self.silent:
                self.last_sent_ns = time.monotonic_ns()
                self.send(self.payload or twist_stamped(self.velocity, time.time_ns()))

    def _request_lease(self) -> None:
        now_ns = time.monotonic_ns()
        payload = dump_json(MotorsRequest(enable=True, name=NAME, sent_ns=now_ns))
        # Without a lease, the bridge treats the signature of the last one as missing.
        tag = self.lease.sign(Signed.MOTORS, "rover/motors", payload, now_ns).pack()
        for reply in self.session.get("rover/motors", payload=payload, attachment=tag, timeout=0.5):
            if reply.ok is not None:
                self.lease.grant(parse_json(MotorsReply, reply.ok.payload.to_bytes()))

    def _odometry(self, sample: zenoh.Sample) -> None:
        with suppress(FormatError):
            self.odometry_ns.append(read_odometry(sample.payload.to_bytes()).stamp_ns)

    def _gate(self, sample: zenoh.Sample) -> None:
        with suppress(FormatError):
            self.gate = parse_json(GateStatus, read_text(sample.payload.to_bytes()))
