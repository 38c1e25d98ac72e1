"""A driver's link to a bridge, without its transport: `zenoh_link` implements it, and the stack simulation.

A link stores what arrives in an `Inbox` for each kind of measurement.
"""

import contextlib
import threading
from abc import ABC, abstractmethod
from collections import deque
from typing import Generic, NamedTuple, TypeVar

from deploy.drive.signed_lease import DriverLease
from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import Velocity
from rover_ncp.wire.messages import read_battery, read_bumpers, read_text
from rover_ncp.wire.protocol import GateStatus, MotorsReply, parse_json

ItemT = TypeVar("ItemT")
INBOX_LENGTH = 1000
CHARGING_NS = 3_000_000_000
"""Longest time without a message of the battery: the bridge sends it once a second."""
REPEATED_NS = 500_000_000
"""Stamps that differ by no more are of one report of the battery."""


class Arrival(NamedTuple):
    """A message and the moment of its arrival on the monotonic clock."""

    data: bytes
    arrival_ns: int


class Inbox(Generic[ItemT]):
    """Keeps the newest ``length`` items until they are taken, and wakes the thread that waits for one.

    Zenoh's own ring channel cannot be waited for with a limit.
    """

    def __init__(self, length: int = INBOX_LENGTH) -> None:
        self._changed = threading.Condition()
        self._items: deque[ItemT] = deque(maxlen=length)

    def put(self, item: ItemT) -> None:
        """Add an item; from any thread."""
        with self._changed:
            self._items.append(item)
            self._changed.notify()

    def take(self, timeout_s: float = 0.0) -> list[ItemT]:
        """Return and remove all items, in order; wait for the first at most ``timeout_s``."""
        with self._changed:
            if not self._items and timeout_s > 0:
                self._changed.wait(timeout_s)
            items = list(self._items)
            self._items.clear()
            return items


class Link(ABC):
    """An open link to one bridge: what arrived, and the lease. A subclass has the transport.

    ``robot`` is the bridge's address and ``where`` its ``namespace`` in words, for messages. ``bridge_alive``
    tells whether the bridge shows its liveliness token.
    """

    robot: str
    where: str
    namespace: str = ""
    bridge_alive: bool

    def __init__(self) -> None:
        self.odometry, self.gyro, self.poses = Inbox[Arrival](1), Inbox[Arrival](), Inbox[Arrival]()
        self.gate = GateStatus()
        """The newest gate status."""
        self.bumped = 0, 0
        """Number of messages that reported a pressed front or rear bumper."""
        self.pressed = False, False
        """Whether they are pressed, by the newest message."""
        self.lease = DriverLease()
        self._charging: tuple[bool | None, int] = None, 0
        """Whether the battery charges by the newest message, and the moment of its arrival."""
        self.battery_reports = self._battery_stamp_ns = 0
        """Number of reports of the battery, of which a message may repeat the last, and that one's stamp."""

    def receive(self, name: str, arrival: Arrival) -> None:
        """Store a message of the bridge; an unreadable gate status is ignored."""
        match name:
            case "odom":
                self.odometry.put(arrival)
            case "imu":
                self.gyro.put(arrival)
            case "pose":
                self.poses.put(arrival)
            case "rover/gate":
                with contextlib.suppress(FormatError):
                    self.gate = parse_json(GateStatus, read_text(arrival.data))
            case "battery_state":
                with contextlib.suppress(FormatError):
                    battery = read_battery(arrival.data)
                    self._charging = battery.charging, arrival.arrival_ns
                    self.battery_reports += abs(battery.stamp_ns - self._battery_stamp_ns) > REPEATED_NS
                    self._battery_stamp_ns = battery.stamp_ns
            case "bumpers":
                with contextlib.suppress(FormatError):
                    front, rear = self.pressed = read_bumpers(arrival.data)
                    self.bumped = self.bumped[0] + front, self.bumped[1] + rear

    @abstractmethod
    def authorised(self) -> bool:
        """Return whether the bridge takes commands from this driver."""

    @abstractmethod
    def request_motors(self, name: str, unchecked: bool = False) -> MotorsReply:
        """Request the motors and with them the lease. Raises UnreachableError or SafetyStop.

        ``unchecked`` also requests a robot that is not known to halt when the bridge dies.
        """

    @abstractmethod
    def release(self) -> None:
        """Stop the rover and release the lease, if this driver holds it; never raises."""

    def charging(self, now_ns: int) -> bool | None:
        """Return whether the battery charges by a report that is not old; None = not known."""
        charging, arrival_ns = self._charging
        return charging if now_ns - arrival_ns <= CHARGING_NS else None

    @abstractmethod
    def command(self, velocity: Velocity) -> int:
        """Send a command, v in m/s and omega in rad/s, and return its sequence number."""

    @abstractmethod
    def publish(self, name: str, data: bytes, wall_ns: int) -> None:
        """Send one of the driver's own messages."""
