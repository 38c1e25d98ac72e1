"""The driver's Zenoh session with the bridge.

Callbacks record a message, note the time and store it. Only the queries block the control loop, and they are
bounded.
"""

import contextlib
import time
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import zenoh

from deploy.drive.link import Arrival, Link, RosCommand
from deploy.zenoh_client import BridgeAddress, ZenohClient, matches, source_of
from rover_ncp.core.errors import (
    AnotherDriver,
    FormatError,
    NoBridge,
    NotAuthorised,
    SafetyStop,
)
from rover_ncp.core.files import DEFAULT_ROBOT
from rover_ncp.core.geometry import STANDSTILL, Velocity
from rover_ncp.recording.recording import Recorded, header_stamp_ns
from rover_ncp.robot.description import RobotDescription
from rover_ncp.robot.profile import RoverProfile
from rover_ncp.wire.key_table import KEYS, KeySpec, Kind, Role, spec, topic_key
from rover_ncp.wire.messages import twist_stamped
from rover_ncp.wire.protocol import (
    TAG_BYTES,
    BaseReply,
    BaseRequest,
    MotorsReply,
    MotorsRequest,
    Signed,
    dump_json,
    parse_json,
)

QUERY_TIMEOUT_S = 2.0
RELEASE_TIMEOUT_S = 1.0
BRIDGES_S = 1.0
ROUND_TRIP_S, REQUEST_TRIES = 0.2, 3
"""The gate takes the request's transit time as the shortest one, and so would not notice a constant delay. A
driver does not drive over a slower link; two slow answers by chance are allowed."""
ANOTHER_DRIVER = "another-driver"
"""The gate's reason when another driver holds the lease."""
_OWN = [row.name for row in KEYS if row.kind is Kind.MESSAGE and row.senders == {Role.DRIVER}]


class ZenohLink(Link, ZenohClient):
    """The link of one driver; ``record`` gets every message in both directions. Raises as `ZenohClient`.

    ``shown``: messages for people, too, such as a localiser's pictures.
    """

    def __init__(
        self, address: BridgeAddress, record: Callable[[Recorded], None], *, shown: bool = False
    ) -> None:
        Link.__init__(self)
        self._records_shown = shown
        self._record, self.where = record, address.where
        self.namespace = address.namespace.strip("/")
        self._token: Any = None
        ZenohClient.__init__(self, address, self._take, own=_OWN)

    def _declare(self) -> None:
        self._publishers = {
            name: self._session.declare_publisher(
                self.key(name),
                encoding=zenoh.Encoding.APPLICATION_CDR,
                # A command that cannot leave at once would be stale later.
                congestion_control=zenoh.CongestionControl.DROP,
            )
            for name in _OWN
        }
        if self._records_shown:
            for row in KEYS:
                if row.shown:
                    self._receive_row(row)

    def authorised(self) -> bool:
        """Whether a subscriber takes our commands: a bridge without permission for us has none."""
        return matches(self._publishers["cmd_vel"])

    def request_motors(self, name: str) -> MotorsReply:
        """Request the motors and with them the lease, or renew the current lease.

        After a slow answer it sends a signed renewal. If the answer was lost, the gate refuses every driver
        until that lease expires.

        Raises AnotherDriver, NotAuthorised, NoBridge (no answer), or SafetyStop when the gate has a reason or
        the link is too slow.
        """
        if self._token is None:
            self._token = self._session.liveliness().declare_token(self.key("rover/alive/driver"))
        for _ in range(REQUEST_TRIES):
            sent_s = time.monotonic()
            request = MotorsRequest(enable=True, name=name)
            reply = self._motors(request, QUERY_TIMEOUT_S)
            round_trip_s = time.monotonic() - sent_s
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
            if reply.reason == ANOTHER_DRIVER:
                raise AnotherDriver(words)
            by = "a stop that is not released" if reply.reason == "stopped" else ""
            raise SafetyStop(reply.reason or "gate", words, by=by)
        if not self.lease.number:
            raise NoBridge(f"the bridge at {self.robot} grants the motors without a key")
        if round_trip_s > ROUND_TRIP_S:
            raise SafetyStop(
                "slow-link",
                f"the bridge at {self.robot} takes {round_trip_s:.2f} s to answer (limit {ROUND_TRIP_S} s)",
            )
        return reply

    def _motors(self, request: MotorsRequest, timeout_s: float) -> MotorsReply | None:
        # The query goes to every peer, and every answer is read: a peer that relays the request to the bridge
        # would get the key.
        replies = list(self._query("rover/motors", request, timeout_s, zenoh.QueryTarget.ALL))
        if len(replies) > 1:
            raise NoBridge(
                f"{len(replies)} answers on {self.key('rover/motors')} at {self.robot}, expected one: a peer "
                "beside the bridge answers requests for the motors; keep it out with 'rover-ncp keys'"
            )
        for reply in replies:
            if reply.ok is None:
                raise NoBridge(f"the bridge at {self.robot} does not answer within {timeout_s:g} s")
            try:
                return parse_json(MotorsReply, reply.ok.payload.to_bytes())
            except FormatError as error:
                raise NoBridge(f"the bridge at {self.robot} sends an unreadable answer: {error}") from error
        return None

    def _query(
        self,
        name: str,
        request: MotorsRequest | BaseRequest,
        timeout_s: float,
        target: zenoh.QueryTarget = zenoh.QueryTarget.BEST_MATCHING,
    ) -> Iterable[zenoh.Reply]:
        """Send a query; a request for the motors is signed if there is a lease."""
        where, now_ns, tag = self.key(name), time.monotonic_ns(), None
        if isinstance(request, MotorsRequest):
            request = request.model_copy(update={"sent_ns": now_ns})
        payload = dump_json(request)
        if self.lease.number and isinstance(request, MotorsRequest):
            tag = self.lease.sign(Signed.MOTORS, where, payload, now_ns).pack()
        return self._session.get(
            where,
            payload=payload,
            attachment=tag,
            timeout=timeout_s,
            target=target,
            consolidation=zenoh.ConsolidationMode.NONE,
            source_info=zenoh.SourceInfo(self._session.id, 0),  # for the bridge's log
        )

    def bridges(self) -> list[str]:
        """Return the namespaces in which a bridge is announced."""
        token = spec("rover/alive/bridge").name
        replies = self._session.liveliness().get(f"**/{token}", timeout=BRIDGES_S)
        found = {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}
        return sorted(name.removesuffix(token).strip("/") for name in found)

    def about_base(self) -> BaseReply | None:
        """Return what the bridge knows of its base; None if the bridge does not answer."""
        replies = self._query("rover/base", BaseRequest(), QUERY_TIMEOUT_S)
        with contextlib.suppress(FormatError, NoBridge):
            answer = self.bridge_answer(replies)
            if answer is not None:
                return parse_json(BaseReply, answer)
        return None

    def other_model(self, robot: RobotDescription | None) -> str:
        """Return a warning if the bridge drives another model than the driver's; "" if not, or not known.

        A driver without a description assumes the default robot.
        """
        base, name = self.about_base(), robot.name if robot else DEFAULT_ROBOT
        if base is None or base.model in {"", name}:
            return ""
        assumed = "" if robot else ", the default"
        return (
            f"warning: the bridge at {self.robot} drives {base.model}, but --model is {name}{assumed}: "
            "its outline, limits and errors may differ"
        )

    def other_profile(self, profile: RoverProfile | None) -> str:
        """Return a warning if a profile was measured with another model than the bridge's; else ""."""
        base, model = self.about_base(), profile and profile.measured.get("model")
        if base is None or not model or base.model in {"", model}:
            return ""
        return (
            f"warning: the profile was measured with {model}, and the bridge at {self.robot} drives "
            f"{base.model}: delays, gains and errors of odometry are those of another robot"
        )

    def release(self) -> None:
        """Stop the rover and release the lease, if we hold it.

        Never raises: if the bridge does not receive it, its own timeout stops the rover.
        """
        if not self.lease.number:
            return
        with contextlib.suppress(zenoh.ZError):
            self.command(STANDSTILL)
        with contextlib.suppress(zenoh.ZError, NoBridge):
            self._motors(MotorsRequest(enable=False), RELEASE_TIMEOUT_S)
        self.lease.end()

    def command(self, velocity: Velocity) -> int:
        """Send a command, v in m/s and omega in rad/s, and return its sequence number."""
        wall_ns = time.time_ns()
        data = twist_stamped(velocity, wall_ns)
        tag = self.lease.sign(Signed.COMMAND, self.key("cmd_vel"), data, time.monotonic_ns())
        self._publishers["cmd_vel"].put(data, attachment=tag.pack())
        self._record(Recorded("cmd_vel", spec("cmd_vel").type, data, wall_ns, wall_ns, tag.sequence))
        return tag.sequence

    def publish(self, name: str, data: bytes, wall_ns: int) -> None:
        """Send and record one of the driver's own messages."""
        self._publishers[name].put(data)
        self._record(Recorded(name, spec(name).type, data, time.time_ns(), wall_ns))

    def subscribe_commands(self, topic: str, receive: Callable[[RosCommand], None]) -> str:
        """Call ``receive`` with each command of a ROS node on a topic, and return its full name.

        Both Zenoh integrations of ROS are received. Messages with a `CommandTag` on the plain key are
        those of drivers with a lease, such as our own. Raises UsageError for a name that is none of a topic.
        """
        where = topic_key(self.address.namespace, topic)

        def take(sample: zenoh.Sample, plain: bool) -> None:
            stamp, tag = sample.timestamp, sample.attachment
            if plain and tag is not None and len(tag.to_bytes()) == TAG_BYTES:
                return
            stamp_ns = None if stamp is None else round(stamp.get_time().timestamp() * 1e9)
            data = sample.payload.to_bytes()[: spec("cmd_vel").max_bytes + 1]
            receive(RosCommand(data, time.monotonic(), source_of(sample), stamp_ns))

        declare = self._session.declare_subscriber
        self._subscribe(declare, where, partial(take, plain=True))
        for name in ("Twist", "TwistStamped"):
            key_expr = f"*/{where}/geometry_msgs::msg::dds_::{name}_/*"
            self._subscribe(declare, key_expr, partial(take, plain=False))
        return f"/{where}"

    def close(self) -> None:
        """Release the lease and end the session."""
        try:
            self.release()
        finally:
            super().close()

    def _take(self, row: KeySpec, data: bytes) -> None:
        arrival, wall_ns = Arrival(data, time.monotonic_ns()), time.time_ns()
        stamp_ns = header_stamp_ns(row.type, data) or 0
        # Recorded first, so that a recording has all inputs of its drive.
        # A negative stamp is no time of a recording.
        self._record(Recorded(row.name, row.type, data, wall_ns, stamp_ns if stamp_ns > 0 else wall_ns))
        self.receive(row.name, arrival)
