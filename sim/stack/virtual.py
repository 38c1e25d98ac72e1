"""Stack simulation: base, bridge and network on a virtual clock, without sockets, Zenoh and waiting.

The simulated robot and the bridge's loop are those of the real processes and exchange the same bytes. The
driver uses `VirtualLink` in place of its Zenoh session. Time passes only while the driver waits, in the order
of events: bytes reach the bridge when the base sends them, and the bridge's loop runs when something arrives
or its timer expires. The latencies of a live run, about a millisecond, do not exist here.
"""

import math
from collections.abc import Callable

from bridge.gate.limits import Limits
from bridge.inbox import CommandMessage, Query
from bridge.node import Node
from deploy.drive.controller import Tick
from deploy.drive.link import Arrival, Inbox, Link
from deploy.drive.records import TickRecord
from deploy.drive.tick_messages import Publisher
from deploy.estimator.estimator import Estimate
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.errors import SafetyStop
from rover_ncp.core.geometry import STANDSTILL, Pose, Velocity
from rover_ncp.recording.recording import Recorded
from rover_ncp.wire.key_table import spec
from rover_ncp.wire.messages import twist_stamped
from rover_ncp.wire.protocol import (
    MotorsReply,
    MotorsRequest,
    Signed,
    dump_json,
    parse_json,
)
from sim.base.firmware import Firmware
from sim.base.ros2_robot import Ros2Robot
from sim.stack.camera import PLACED, start_pose
from sim.stack.lines import WALL_NS, ArcosConnection, Ros2Connection

_WAKE_MARGIN_NS = 1000
"""Delay of each timed event, so that rounding to whole ns never makes it too early."""


class VirtualBridge:
    """A robot with its bridge. The robot's clock must begin at 0.

    This object is the inbox, the Zenoh session and the clock of the bridge's loop (`Node`), and the clock of
    the driver.
    """

    def __init__(self, robot: Firmware | Ros2Robot, limits: Limits | None = None) -> None:
        self.connection = (
            ArcosConnection(robot, limits) if isinstance(robot, Firmware) else Ros2Connection(robot, limits)
        )
        self.now_ns = 0
        self.deliver: Callable[[str, bytes], None] = lambda name, data: None
        """Called with all that the bridge publishes: topic and CDR bytes."""
        self._inbox: list[object] = []
        self._node = Node(
            self.connection.base,
            self.take,
            key=self.key,
            publish=self.publish,
            limits=self.connection.limits,
            ready=lambda: None,
            clock=self,
            suspended_s=self.suspended_s,
        )

    # The clock.

    def monotonic(self) -> float:
        """Return the virtual time in s."""
        return self.now_ns / NS_PER_S

    def monotonic_ns(self) -> int:
        """Return the virtual time in ns."""
        return self.now_ns

    def time_ns(self) -> int:
        """Return the virtual wall clock's time."""
        return WALL_NS + self.now_ns

    def suspended_s(self) -> float:
        """Return 0: the virtual computer is never suspended."""
        return 0.0

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        self.wait(seconds, lambda: False)

    def wait(self, seconds: float, condition: Callable[[], bool]) -> None:
        """Let time pass until ``condition`` holds, at most ``seconds``."""
        until_ns = self.now_ns + max(math.ceil(seconds * NS_PER_S), 0)
        self._run_node()
        while not condition() and self.now_ns < until_ns:
            due_s = min(self.connection.due_s, self._node.due_s)
            due_ns = until_ns if math.isinf(due_s) else math.ceil(due_s * NS_PER_S) + _WAKE_MARGIN_NS
            self.now_ns = min(max(due_ns, self.now_ns), until_ns)
            self.connection.advance(self.monotonic())
            self._run_node()

    def _run_node(self) -> None:
        connection, node = self.connection, self._node
        while connection.arrivals or self._inbox or node.due_s * NS_PER_S + _WAKE_MARGIN_NS <= self.now_ns:
            node.run_once()

    # What the driver sends.

    def command(self, data: bytes, attachment: bytes) -> None:
        """Send a command; the bridge receives it before more time passes."""
        self._inbox.append(CommandMessage(data, attachment))

    def query(self, name: str, payload: bytes, attachment: bytes | None = None) -> bytes:
        """Return the bridge's reply to a query. Raises RuntimeError if the bridge rejects the query."""
        replies: list[bytes] = []
        refusals: list[str] = []
        self._inbox.append(Query(name, payload, attachment, replies.append, refusals.append))
        self._run_node()
        if not replies:
            raise RuntimeError(f"the bridge rejected the query {name}: {', '.join(refusals)}")
        return replies[0]

    # What the bridge's loop calls: its inbox and its Zenoh session.

    def take(self, timeout_s: float) -> list[tuple[float, object]]:
        """Return what arrived. ``timeout_s`` is ignored: only `wait` advances time."""
        arrived = [*self.connection.arrivals, *self._inbox]
        self.connection.arrivals.clear()
        self._inbox.clear()
        return [(self.monotonic(), arrival) for arrival in arrived]

    def key(self, name: str) -> str:
        """Return the key expression of a topic: the topic itself, without a namespace."""
        return name

    def publish(self, name: str, data: bytes) -> None:
        """Deliver a message to the driver."""
        self.deliver(name, data)


class _OdometryInbox(Inbox[Arrival]):
    """The newest odometry; time passes while the driver waits for it."""

    def __init__(self, bridge: VirtualBridge) -> None:
        super().__init__(1)
        self._bridge = bridge

    def take(self, timeout_s: float = 0.0) -> list[Arrival]:
        self._bridge.wait(timeout_s, lambda: bool(self._items))
        return super().take()


class TicklessPublisher(Publisher):
    """A publisher that drops ticks, for drives without subscribers and without a recording.

    It still publishes the status, and records start and dock.
    """

    def tick(self, record: TickRecord, estimate: Estimate, tick: Tick | None) -> None:
        """Do nothing."""


class VirtualLink(Link):
    """A driver's link on the virtual clock.

    Until the driver requests the lease, each odometry message also brings an external pose ``start`` (unless
    None). Received messages go to ``record``.
    """

    robot, where = "virtual", ""
    bridge_alive = True

    def __init__(
        self,
        bridge: VirtualBridge,
        start: Pose | None,
        record: Callable[[Recorded], None] = lambda message: None,
    ) -> None:
        super().__init__()
        self.bridge, self._start, self._record = bridge, start, record
        self.declare(PLACED)
        self.odometry = _OdometryInbox(bridge)
        self.first_command_ns: int | None = None
        """When the first command was sent."""
        self._requested = False
        bridge.deliver = self._receive

    def authorised(self) -> bool:
        """Return True: the simulation authorises every driver."""
        return True

    def request_motors(self, name: str) -> MotorsReply:
        """Request the lease. Raises SafetyStop if it is refused."""
        self._requested = True
        reply = self._motors(MotorsRequest(enable=True, name=name))
        if not reply.granted:
            raise SafetyStop(reply.reason or "gate", reply.detail)
        self.lease.grant(reply)
        return reply

    def release(self) -> None:
        """Stop and release the lease, if this driver holds it."""
        if self.lease.number:
            self.command(STANDSTILL)
            self._motors(MotorsRequest(enable=False))
            self.lease.end()

    def command(self, velocity: Velocity) -> int:
        """Send a command and return its sequence number."""
        bridge = self.bridge
        if self.first_command_ns is None:
            self.first_command_ns = bridge.now_ns
        data = twist_stamped(velocity, bridge.time_ns())
        tag = self.lease.sign(Signed.COMMAND, "cmd_vel", data, bridge.now_ns)
        bridge.command(data, tag.pack())
        return tag.sequence

    def publish(self, name: str, data: bytes, wall_ns: int) -> None:
        """Discard a message: the simulation has no subscriber to the driver's own topics."""

    def _motors(self, request: MotorsRequest) -> MotorsReply:
        payload = dump_json(request.model_copy(update={"sent_ns": self.bridge.now_ns}))
        tag = None
        if self.lease.number:
            tag = self.lease.sign(Signed.MOTORS, "rover/motors", payload, self.bridge.now_ns).pack()
        return parse_json(MotorsReply, self.bridge.query("rover/motors", payload, tag))

    def _receive(self, name: str, data: bytes) -> None:
        wall_ns = self.bridge.time_ns()
        self._record(Recorded(name, spec(name).type, data, wall_ns, wall_ns))
        self.receive(name, Arrival(data, self.bridge.now_ns))
        if name == "odom" and self._start is not None and not self._requested:
            self.poses.put(Arrival(start_pose(self._start, wall_ns), self.bridge.now_ns))

    def localise(self, data: bytes, arrival_ns: int) -> None:
        """Deliver an external pose that arrived at ``arrival_ns``, shortly before the bridge's time."""
        wall_ns = WALL_NS + arrival_ns
        self._record(Recorded("pose", spec("pose").type, data, wall_ns, wall_ns))
        self.poses.put(Arrival(data, arrival_ns))
