"""The driver's Zenoh session with the bridge.

Callbacks receive samples, note the time and store them: the newest odometry in a mailbox of one place (a ring
of one that can be waited for, which Zenoh's cannot), everything in the recorder's queue. Only the queries
block the control loop, and they are bounded.
"""

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import zenoh

from deploy.drive.lease import DriverLease
from deploy.drive.zenoh_config import client_config, refused
from rover_ncp.core.errors import (
    AnotherDriver,
    FormatError,
    NoBridge,
    NotAuthorised,
    OtherVersion,
    SafetyStop,
)
from rover_ncp.core.geometry import Velocity
from rover_ncp.core.key_table import KEYS, Kind, Role, key, spec
from rover_ncp.core.messages import read_text, twist_stamped
from rover_ncp.core.protocol import (
    PROTOCOL,
    VERSION_REASON,
    GateStatus,
    MotorsReply,
    MotorsRequest,
    Signed,
    dump_json,
    other_version,
    parse_json,
)
from rover_ncp.core.recording import Recorded, header_stamp_ns

QUERY_TIMEOUT_S = 2.0
RELEASE_TIMEOUT_S = 1.0
ROUND_TRIP_S, ASK_TRIES = 0.2, 3
"""The gate takes the request's transit time as the shortest one. It could not distinguish commands with a
constant delay from fresh ones. So a driver refuses to drive over a slower link; two slow answers by chance
are allowed."""
ANOTHER_DRIVER = "another-driver"
"""The gate's name for it."""


class Arrival(NamedTuple):
    """A sample with the moment of its arrival, on the monotonic and on the wall clock."""

    data: bytes
    arrival_ns: int
    wall_ns: int


class Mailbox:
    """Keeps the newest arrival only, and wakes the waiting thread."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._newest: Arrival | None = None

    def put(self, arrival: Arrival) -> None:
        """Replace the stored arrival."""
        with self._changed:
            self._newest = arrival
            self._changed.notify()

    def take(self, timeout_s: float) -> Arrival | None:
        """Return and remove the stored arrival; wait for it at most ``timeout_s``."""
        with self._changed:
            if self._newest is None and timeout_s > 0:
                self._changed.wait(timeout_s)
            newest, self._newest = self._newest, None
            return newest


class Inbox:
    """Keeps every arrival until it is taken, but no more than so many."""

    LENGTH = 1000

    def __init__(self) -> None:
        self._arrivals: deque[Arrival] = deque(maxlen=self.LENGTH)

    def put(self, arrival: Arrival) -> None:
        """Add an arrival; from any thread."""
        self._arrivals.append(arrival)

    def take(self) -> list[Arrival]:
        """Return and remove all arrivals, in order."""
        return [self._arrivals.popleft() for _ in range(len(self._arrivals))]


class Link:
    """One session with one bridge.

    Opening it raises NoBridge when nothing answers at ``robot``, NotAuthorised when it rejects the session.
    """

    def __init__(
        self,
        robot: str,
        namespace: str,
        zenoh_config: Path | None,
        record: Callable[[Recorded], None],
    ) -> None:
        self._namespace = namespace
        self._record = record
        self._key("odom")  # a bad namespace is said before anything is opened
        config, locator = client_config(robot, zenoh_config)
        self.robot = locator
        self.lease = DriverLease()
        self.odometry = Mailbox()
        self.gyro = Inbox()
        self.poses = Inbox()
        """External localisation, in the course's frame."""
        self.bridge_alive = False
        self.gate = GateStatus()
        """The newest gate status."""
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            raise refused(locator) from error
        try:
            self._declare()
        except BaseException:
            self._session.close()  # type: ignore[no-untyped-call]
            raise

    def _declare(self) -> None:
        self._publishers = {
            row.name: self._session.declare_publisher(
                self._key(row.name),
                encoding=zenoh.Encoding.APPLICATION_CDR,
                # A command that cannot leave at once would be stale later.
                congestion_control=zenoh.CongestionControl.DROP,
            )
            for row in KEYS
            if row.kind is Kind.MESSAGE and row.senders == {Role.DRIVER}
        }
        handed_on: dict[str, Callable[[Arrival], None]] = {
            "odom": self.odometry.put,
            "imu": self.gyro.put,
            "pose": self.poses.put,
            "rover/gate": self._gate_spoke,
        }
        self._subscribers = [
            self._session.declare_subscriber(
                self._key(row.name), self._receiving(row.name, handed_on.get(row.name))
            )
            for row in KEYS
            if row.kind is Kind.MESSAGE and row.name not in self._publishers
        ]
        self._token: Any = None
        self._bridge_token = self._session.liveliness().declare_subscriber(
            self._key("rover/alive/bridge"), self._bridge_token_changed, history=True
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def authorised(self) -> bool:
        """Whether a subscriber takes our commands: a bridge without permission for us has none."""
        # The object is truthy whatever it says, and Zenoh's stub takes it for a bool.
        status: Any = self._publishers["cmd_vel"].matching_status
        return bool(status.matching)

    def request_motors(self, name: str) -> MotorsReply:
        """Request the motors and with them the lease, or renew the current lease.

        If the answer takes too long, it asks again with a signed renewal. If the answer was lost, the gate
        refuses every driver, this one too, until that lease lapses.

        Raises AnotherDriver, NotAuthorised, NoBridge (no answer), OtherVersion, or SafetyStop when the gate
        has a reason or the link is too slow.
        """
        if self._token is None:
            self._token = self._session.liveliness().declare_token(self._key("rover/alive/driver"))
        for _ in range(ASK_TRIES):
            asked_s = time.monotonic()
            reply = self._motors(enable=True, name=name, timeout_s=QUERY_TIMEOUT_S)
            round_trip_s = time.monotonic() - asked_s
            if reply is not None and reply.granted:
                self.lease.grant(reply)
            if round_trip_s <= ROUND_TRIP_S:
                break
        if reply is None:
            raise NotAuthorised(
                f"not authorised: the bridge at {self.robot} does not take our request for the motors"
            )
        if not reply.granted:
            words = f"the bridge at {self.robot} refuses the motors: {reply.detail or reply.reason}"
            if reply.reason == VERSION_REASON:
                raise OtherVersion(words)
            if reply.reason == ANOTHER_DRIVER:
                raise AnotherDriver(words)
            raise SafetyStop(reply.reason or "gate", words)
        if not self.lease.number:
            raise NoBridge(f"the bridge at {self.robot} grants the motors without a key")
        if round_trip_s > ROUND_TRIP_S:
            raise SafetyStop(
                "slow-link",
                f"the bridge at {self.robot} takes {round_trip_s:.2f} s to answer (at most {ROUND_TRIP_S} s)",
            )
        return reply

    def _motors(self, enable: bool, name: str, timeout_s: float) -> MotorsReply | None:
        now_ns = time.monotonic_ns()
        payload = dump_json(MotorsRequest(enable=enable, name=name, sent_ns=now_ns))
        where, tag = self._key("rover/motors"), None
        if self.lease.number:
            tag = self.lease.sign(Signed.MOTORS, where, payload, now_ns).pack()
        # Every peer that would answer is asked, and every answer is seen: a peer that relayed the request to
        # the bridge and passed the answer on would know the key.
        replies = list(
            self._session.get(
                where,
                payload=payload,
                attachment=tag,
                timeout=timeout_s,
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
            )
        )
        if len(replies) > 1:
            raise NoBridge(
                f"{len(replies)} answers on {where} at {self.robot}, expected one: a peer beside the bridge "
                "answers requests for the motors; keep it out with 'rover-ncp keys'"
            )
        for reply in replies:
            # A bridge of version 1 cannot read the request, and says so; later ones answer with a refusal.
            if reply.err is not None and reply.err.payload.to_bytes().startswith(b"MotorsRequest: "):
                words = other_version(1, PROTOCOL)
                raise OtherVersion(f"the bridge at {self.robot} refuses the motors: {words}")
            if reply.ok is None:
                raise NoBridge(f"the bridge at {self.robot} does not answer within {timeout_s:g} s")
            try:
                return parse_json(MotorsReply, reply.ok.payload.to_bytes())
            except FormatError as error:
                raise NoBridge(f"the bridge at {self.robot} sends an unreadable answer: {error}") from error
        return None

    def release(self) -> None:
        """Stop and release the lease, if we hold it.

        Never raises: if the bridge does not receive it, its own timeout stops the rover.
        """
        if not self.lease.number:
            return
        with contextlib.suppress(zenoh.ZError):
            self.command(Velocity(0.0, 0.0))
        with contextlib.suppress(zenoh.ZError, NoBridge, OtherVersion):
            self._motors(enable=False, name="", timeout_s=RELEASE_TIMEOUT_S)
        self.lease.end()

    def command(self, velocity: Velocity) -> int:
        """Send a command, v in m/s and omega in rad/s, and return its sequence number."""
        wall_ns = time.time_ns()
        data = twist_stamped(velocity, wall_ns)
        tag = self.lease.sign(Signed.COMMAND, self._key("cmd_vel"), data, time.monotonic_ns())
        self._publishers["cmd_vel"].put(data, attachment=tag.pack())
        self._record(Recorded("cmd_vel", spec("cmd_vel").type, data, wall_ns, wall_ns, tag.sequence))
        return tag.sequence

    def publish(self, name: str, data: bytes, wall_ns: int) -> None:
        """Send and record one of the driver's own messages."""
        self._publishers[name].put(data)
        self._record(Recorded(name, spec(name).type, data, time.time_ns(), wall_ns))

    def close(self) -> None:
        """Release the lease and end the session."""
        try:
            self.release()
        finally:
            self._session.close()  # type: ignore[no-untyped-call]

    def _key(self, name: str) -> str:
        return key(self._namespace, name)

    def _receiving(
        self, name: str, hand_on: Callable[[Arrival], None] | None
    ) -> Callable[[zenoh.Sample], None]:
        ros_type = spec(name).type

        def receive(sample: zenoh.Sample) -> None:
            arrival = Arrival(sample.payload.to_bytes(), time.monotonic_ns(), time.time_ns())
            stamp_ns = header_stamp_ns(ros_type, arrival.data) or arrival.wall_ns
            # Recorded first, so that a recording has all inputs of its drive.
            self._record(Recorded(name, ros_type, arrival.data, arrival.wall_ns, stamp_ns))
            if hand_on is not None:
                hand_on(arrival)

        return receive

    def _gate_spoke(self, arrival: Arrival) -> None:
        # An unreadable status is ignored: the previous one stays valid.
        with contextlib.suppress(FormatError):
            self.gate = parse_json(GateStatus, read_text(arrival.data))

    def _bridge_token_changed(self, sample: zenoh.Sample) -> None:
        self.bridge_alive = sample.kind == zenoh.SampleKind.PUT
