"""A driver's link to a bridge, without its transport: `zenoh_link` implements it, and the stack simulation.

A link stores what arrives in an `Inbox` for each kind of measurement.
"""

import math
import threading
from abc import ABC, abstractmethod
from collections import deque
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from deploy.drive.signed_lease import DriverLease
from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import Velocity, same_frame
from rover_ncp.robot.description import RobotDescription
from rover_ncp.robot.lasting_error import UNDECLARED, Declaration, LastingError
from rover_ncp.wire.messages import read_battery, read_bumpers, read_docked, read_points, read_text
from rover_ncp.wire.protocol import BaseReply, GateStatus, MotorsReply, parse_json

ItemT = TypeVar("ItemT")
INBOX_LENGTH = 1000
CHARGING_NS = 3_000_000_000
"""Longest time without a message of the battery: the bridge sends it once a second."""
ECHO_NS = 1_000_000_000
"""How long an echo counts: each message has those of a part of the sonars."""
SONAR_LENGTH = 100
"""Messages of the sonars that are kept: more than come while an echo counts."""
REPEATED_NS = 500_000_000
"""Stamps that differ by no more are of one report of the battery."""
MAX_FRAMES = 16
"""Frames of external poses whose errors are kept."""


class Arrival(NamedTuple):
    """A message and the moment of its arrival on the monotonic clock."""

    data: bytes
    arrival_ns: int


class RosCommand(NamedTuple):
    """A command of a ROS node, and when it arrived on the monotonic clock.

    ``source`` identifies its publisher, "" if nothing does. ``stamp_ns`` is when it was sent, by its sender's
    wall clock, if that is known.
    """

    data: bytes
    arrived_s: float
    source: str = ""
    stamp_ns: int | None = None


class Bumpers(NamedTuple):
    """The front and the rear bumper."""

    pressed: tuple[bool, bool] = False, False
    """Whether they are pressed, by the newest message."""
    times: tuple[int, int] = 0, 0
    """Number of messages that reported them as pressed."""


class Charge(NamedTuple):
    """What the newest message of the battery says of its charge."""

    charging: bool | None = None
    reports: int = 0
    """Number of the battery's reports so far; a message may repeat the last."""
    stamp_ns: int = 0
    arrival_ns: int = 0

    def at(self, now_ns: int) -> bool | None:
        """Return whether the battery charges; None if that is not known, or the message is old."""
        return self.charging if now_ns - self.arrival_ns <= CHARGING_NS else None


class DockedTopic(NamedTuple):
    """What the newest message of the robot's topic says, and the number of them."""

    docked: bool | None = None
    reports: int = 0


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
        self.bumpers = Bumpers()
        self.charge, self.docked = Charge(), DockedTopic()
        self._lasting: dict[str, LastingError] = {}
        """What sources of external poses declare, by the frame of the poses; "" is of any other frame."""
        self._sonar = Inbox[Arrival](SONAR_LENGTH)
        """Messages of the sonars that are not decoded yet: few drives use them."""
        self._echoes = deque[tuple[int, float]](maxlen=SONAR_LENGTH)
        """Arrival and distance of the nearest echo of each message of the sonars that had one, in m."""
        self.lease = DriverLease()
        self.complaints: dict[str, str] = {}
        """Why the first message of a topic that was not used could not be."""

    def receive(self, name: str, arrival: Arrival) -> None:
        """Store a message; one that cannot be read is ignored, and is a complaint."""
        try:
            self._store(name, arrival)
        except FormatError as error:
            self.complaints.setdefault(name, str(error))

    def _store(self, name: str, arrival: Arrival) -> None:
        # The control loop runs in another thread: what it reads together is one object, replaced at once.
        match name:
            case "odom":
                self.odometry.put(arrival)
            case "imu":
                self.gyro.put(arrival)
            case "pose":
                self.poses.put(arrival)
            case "rover/localiser":
                declared = parse_json(Declaration, read_text(arrival.data))
                self.declare(declared, declared.frame)
            case "rover/gate":
                self.gate = parse_json(GateStatus, read_text(arrival.data))
            case "battery_state":
                battery, before = read_battery(arrival.data), self.charge
                is_new = abs(battery.stamp_ns - before.stamp_ns) > REPEATED_NS
                self.charge = Charge(
                    battery.charging, before.reports + is_new, battery.stamp_ns, arrival.arrival_ns
                )
            case "sonar":
                self._sonar.put(arrival)
            case "docked":
                self.docked = DockedTopic(read_docked(arrival.data)[0], self.docked.reports + 1)
            case "bumpers":
                pressed, times = read_bumpers(arrival.data), self.bumpers.times
                self.bumpers = Bumpers(pressed, (times[0] + pressed[0], times[1] + pressed[1]))

    def declare(self, error: LastingError, frame: str = "") -> None:
        """Store the lasting error of the external poses in a frame."""
        if frame in self._lasting or len(self._lasting) < MAX_FRAMES:
            self._lasting = {**self._lasting, frame: error}

    def lasting_error(self, frame: str, robot: RobotDescription | None = None) -> LastingError:
        """Return the lasting error of the external poses in a frame.

        The robot's description counts first, then a source that names the frame, then one that names none.
        """
        named = [error for name, error in self._lasting.items() if name and same_frame(name, frame)]
        described = None if robot is None else robot.lasting_error
        return described or (named[0] if named else self._lasting.get("", UNDECLARED))

    def nearest_echo_m(self, now_ns: int) -> float:
        """Return the distance of the nearest new echo of the sonars from base_link; infinite without any."""
        for data, arrival_ns in self._sonar.take():
            try:
                points = read_points(data)
            except FormatError as error:
                self.complaints.setdefault("sonar", str(error))
                continue
            distances = np.hypot(points[:, 0], points[:, 1])
            if np.isfinite(distances).any():
                self._echoes.append((arrival_ns, float(np.nanmin(distances))))
        return min((m for arrived, m in self._echoes if now_ns - arrived <= ECHO_NS), default=math.inf)

    @abstractmethod
    def authorised(self) -> bool:
        """Return whether the bridge takes commands from this driver."""

    @abstractmethod
    def request_motors(self, name: str) -> MotorsReply:
        """Request the motors and with them the lease. Raises UnreachableError or SafetyStop."""

    def bridges(self) -> list[str]:
        """Return the namespaces in which a bridge is announced."""
        return []

    def about_base(self) -> BaseReply | None:
        """Return what the bridge knows of its base; None if it does not answer."""
        return None

    @abstractmethod
    def release(self) -> None:
        """Stop the rover and release the lease, if this driver holds it; never raises."""

    @abstractmethod
    def command(self, velocity: Velocity) -> int:
        """Send a command, v in m/s and omega in rad/s, and return its sequence number."""

    @abstractmethod
    def publish(self, name: str, data: bytes, wall_ns: int) -> None:
        """Send one of the driver's own messages."""
