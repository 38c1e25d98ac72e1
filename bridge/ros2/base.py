"""A ROS 2 robot as a `Base`: Odometry in, Twist out. Pure; the sessions are in `connection.py`.

Rules of this file:

1. The base is ready while odometry arrives often enough and nothing contradicts it. Else it is lost, with the
   reason, and a driver must request the lease again.
2. The robot gets a command at least each `REFRESH_S`, zero unless the gate says otherwise.
3. A message on ``cmd_vel`` that is not ours stops the rover. One that is ours came back through a loop: then
   drivers' commands could reach the robot past the gate.
"""

import math
from collections import deque
from collections.abc import Sequence

from bridge.base import (
    BaseEvent,
    BaseReport,
    BaseTimeout,
    Failed,
    LinkHealth,
    Lost,
    Notice,
    Ready,
    Recovered,
    Setpoint,
)
from bridge.inbox import RobotMessage
from bridge.ros2.address import hazard_topics, sensor_topics
from bridge.ros2.announced import AnnouncedTopics
from bridge.ros2.base_timeout import TimeoutRecord
from bridge.ros2.connection import RosConnection
from bridge.ros2.discovery import LoopSeen, TokenSeen
from bridge.ros2.gyro import GyroTurns
from bridge.ros2.hazards import Hazards
from bridge.ros2.inputs import DockedReports, RosBattery, pose_passed_on
from bridge.ros2.odometry import LOSS_S, MIN_IN_RATE, RATE_S, Moved, RosOdometer
from bridge.ros2.scan import ScanRoom
from bridge.ros2.unused import UnusedMessages
from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import STANDSTILL, Velocity
from rover_ncp.robot.description import RobotDescription
from rover_ncp.robot.topics import Topics
from rover_ncp.wire.cdr import encode
from rover_ncp.wire.message_parts import header_of
from rover_ncp.wire.messages import (
    BUMP,
    CLIFF,
    ODOMETRY,
    STALL,
    TWIST,
    TWIST_STAMPED,
    WHEEL_DROP,
)

REFRESH_S = 0.05
"""Bases stop without commands after 0.25 s at the earliest (Husky under ROS 1)."""
LAST_ZEROS = 5
"""Zeros before the session ends, `REFRESH_S` apart: each of them may be dropped."""
REPORT_S = 0.018
"""Odometry at a higher rate is passed on at most this often."""
WAIT_S = 6.0
"""A robot that is not ready after this time cannot be served."""
CLEAR_S = 2.0
"""How long a contradiction must be over before the base is ready again."""
OWN_S = 2.0
"""How long after it was sent a command of ours is recognised."""
COAST_S, DRIVES_ALONE_S = 2.0, 0.5
"""A robot that still drives so long after the last command, for so long, is driven by another."""
MOVING_M_S, MOVING_RAD_S = 0.05, 0.15
_BUMPERS = frozenset({BUMP, CLIFF, WHEEL_DROP})
_LOOP = (
    "the robot's Zenoh network is connected to the drivers': commands could reach the robot past the bridge; "
    "connect the ROS bridge or rmw_zenohd to one of the two"
)
_DRIVEN = "the robot drives although the bridge sends zeros: another node or a person drives it"


def command(topics: Topics, velocity: Velocity, stamp_ns: int) -> bytes:
    """Return a command in the type that the robot takes; ``stamp_ns`` is of the robot's clock.

    The unused speed is −0, which other publishers do not send: so a zero of ours is recognised.
    """
    twist = {"linear": {"x": velocity.v, "z": -0.0}, "angular": {"z": velocity.omega}}
    if topics.cmd_vel_type == "Twist":
        return encode(TWIST, **twist)
    return encode(TWIST_STAMPED, header=header_of(stamp_ns, topics.base_frame), twist=twist)


class Ros2Base:
    """One robot, described by ``description``, whose ``topics`` are not None.

    ``unsafe`` is whether every driver may drive although the robot is not known to halt without commands.
    """

    def __init__(self, line: RosConnection, description: RobotDescription, unsafe: bool) -> None:
        assert description.topics is not None
        self._line, self._description, self._topics = line, description, description.topics
        self._odometer = RosOdometer(self._topics, description.motion, line.topic(self._topics.odom))
        self._announced = AnnouncedTopics(line.topic, line.zid)
        self._contradictions: dict[str, float] = {}
        """Reasons against being ready, and when each was last seen."""
        self._loop = self._ready = self._was_ready = False
        self._known_restarts = 0
        self._began_s: float | None = None
        self._sent: deque[tuple[float, bytes]] = deque(maxlen=256)
        self._out = STANDSTILL
        self._lease = 0
        """Number of the lease of the last setpoint."""
        self._driven_s = self._reported_s = -math.inf
        self._alone_since_s: float | None = None
        self._battery, self._docked = RosBattery(), DockedReports(self._topics.docked_field)
        self._hazards = Hazards(self._topics)
        self._hazard_types = {found.topic: kind for found, kind in hazard_topics(self._topics)}
        self._unused = UnusedMessages(line.topic)
        topics = self._topics
        self._types = dict(sensor_topics(topics)) | self._hazard_types
        # Odometry has words of its own, and a dock may report seldom.
        self._unheard = {
            name: kind for name, kind in self._types.items() if name not in {topics.odom, topics.docked}
        }
        """Topics on which no message came, and their types."""
        self._turns = GyroTurns()
        self._room = ScanRoom(description) if self._topics.scan is not None else None
        self._timeout = TimeoutRecord(description.measured_base_timeout_s, unsafe)
        self.silent = False
        """Whether the robot gets nothing while its timeout is measured; the end of the lease ends it."""

    def receive(self, arrival: object, now: float) -> Sequence[BaseEvent]:
        events, changes = list[BaseEvent](), list[BaseEvent]()
        match arrival:
            case RobotMessage():
                events = self._message(arrival)
                if arrival.topic == self._topics.odom:
                    changes += map(Notice, self._odometer.notices)
            case TokenSeen(token, there):
                self._announced.update(token, there)
                for topic, kind in self._hazard_types.items():
                    if not there and token.ros_type == kind and self._announced.publishes(token, topic):
                        self._hazards.lose_publisher(topic, token.source)
            case LoopSeen(there):
                self._loop = there
        changes += self._watch(now)
        changes += [Notice(line) for line in self._unused.notices(now, self._topics.odom)]
        return [*changes, *events] if self._ready else changes

    def drive(self, setpoint: Setpoint, now: float) -> Sequence[BaseEvent]:
        events = self._watch(now)
        velocity = setpoint.velocity if setpoint.motors and self._ready else STANDSTILL
        same_lease, self._lease = setpoint.lease == self._lease, setpoint.lease
        ends = setpoint.emergency or not (setpoint.motors and setpoint.lease and same_lease and self._ready)
        self.silent &= not ends
        if self.silent:
            self._driven_s = now
            return events
        if velocity != self._out or not self._sent or now - self._sent[-1][0] >= REFRESH_S:
            self._send(velocity, now)
        if velocity != STANDSTILL:
            self._driven_s = now
        return events

    @property
    def last_sent_s(self) -> float:
        """When the robot was sent its last command."""
        return self._sent[-1][0] if self._sent else -math.inf

    def health(self) -> LinkHealth:
        counters = self._odometer.counters | self._unused.counts
        unheard = tuple(
            self._unused.words(topic) or self._announced.found_instead(topic, wanted)
            for topic, wanted in self._unheard.items()
        )
        return LinkHealth(bool(self._unused.topics), counters, unheard, self._odometer.clock)

    @property
    def note(self) -> str:
        """Text for the log at each start."""
        return self._timeout.note

    @property
    def base_timeout(self) -> BaseTimeout:
        known = self._timeout
        return BaseTimeout(known.state, known.described_s, known.refusal)

    def close(self, now: float) -> None:
        try:
            for number in range(LAST_ZEROS):
                self._send(STANDSTILL, now + number * REFRESH_S)
                self._line.wait(REFRESH_S)
        finally:
            self._line.close()

    # Messages.

    def _message(self, message: RobotMessage) -> list[BaseEvent]:
        topic, now = message.topic, message.arrived_s
        if topic == self._topics.odom:
            moved = self._odometer.take(message.payload, now, message.source)
            if moved is None:
                self._unused.add(topic, self._odometer.problem, now)
                return []
            self._unused.end(topic)
            return self._report(moved, now)
        try:
            events = self._take(topic, message)
        except FormatError as error:
            self._unused.add(topic, str(error), now)
            return []
        self._unused.end(topic)
        self._unheard.pop(topic, None)
        return events

    def _take(self, topic: str, message: RobotMessage) -> list[BaseEvent]:
        """Take a message of another topic than odometry. Raises FormatError for one that cannot be used."""
        now = message.arrived_s
        # A message of another type may be read as one of the described type. Both types of poses can be read.
        wanted = "" if topic == self._topics.pose else self._types.get(topic, "")
        if wanted and (problem := self._announced.type_problem(topic, wanted)):
            self._hazards.reject(topic, problem)
            raise FormatError(problem)
        if topic == self._topics.cmd_vel:
            self._other_command(message)
        elif topic == self._topics.imu:
            self._turns.take(message.payload, now)
        elif topic == self._topics.scan and self._room is not None:
            self._room.take(message.payload, now)
        elif topic in self._hazards.topics:
            self._hazards.take(topic, message.payload, now, message.source)
        elif topic == self._topics.docked:
            return [*self._docked.take(message.payload)]
        elif topic == self._topics.pose:
            return [pose_passed_on(message.payload)]
        elif topic == self._topics.battery_state:
            self._battery.take(message.payload, now)
        return []

    def _report(self, moved: Moved, now: float) -> list[BaseEvent]:
        v, omega = moved.velocity
        drives = abs(v) > MOVING_M_S or abs(omega) > MOVING_RAD_S
        if not drives or now - self._driven_s < COAST_S or not self._was_ready:
            self._alone_since_s = None
        elif self._alone_since_s is None:
            self._alone_since_s = now
        elif now - self._alone_since_s > DRIVES_ALONE_S:
            self._contradictions[_DRIVEN] = now
        if now - self._reported_s < REPORT_S:
            return []
        self._reported_s = now
        turn = self._turns.since_last(now)
        events: list[BaseEvent] = [turn] if turn is not None else []
        x, y, theta = moved.pose
        ahead, behind = self._room.clear(now) if self._room is not None else (math.nan, math.nan)
        stop_pressed, hazards = self._hazards.since_last()
        unknown = self._hazards.unknown(
            now, self._line.topic, lambda topic: self._announced.publishers(topic, self._hazard_types[topic])
        )
        battery, age_s = self._battery.state(now)
        report = BaseReport(
            *(x, y, theta, v, omega),
            age_s=moved.age_s,
            battery_v=battery.voltage,
            charging=battery.charging,
            battery_age_s=age_s,
            stop_pressed=stop_pressed,
            hazard_unknown=unknown,
            stalled=(STALL in hazards, STALL in hazards),
            # Bumpers and cliff sensors are in front. With a dropped wheel no direction is free.
            bumpers=(int(not hazards.isdisjoint(_BUMPERS)), int(WHEEL_DROP in hazards)),
            clear_ahead_m=ahead,
            clear_behind_m=behind,
            room_unknown=self._room_unknown(now),
        )
        return [*events, report]

    def _room_unknown(self, now: float) -> str:
        if self._room is None or self._topics.scan is None or not (words := self._room.unknown(now)):
            return ""
        return self._unused.words(self._topics.scan) or f"{self._line.topic(self._topics.scan)}: {words}"

    def _other_command(self, message: RobotMessage) -> None:
        """Find out whether a message on ``cmd_vel`` is ours that came back, or another publisher's."""
        now, where = message.arrived_s, self._line.topic(self._topics.cmd_vel)
        own = message.source is not None and message.source == self._line.source
        if own or any(now - at < OWN_S and data == message.payload for at, data in self._sent):
            self._contradictions[
                f"the bridge's own commands on {where} come back to it, or another bridge drives this robot"
            ] = now
            return
        who = (
            " or ".join(self._announced.publisher_names(self._topics.cmd_vel)) or "a publisher without a name"
        )
        self._contradictions[f"{who} publishes {where} too"] = now
        self._odometer.counters["foreign"] += 1

    # State.

    def _watch(self, now: float) -> list[BaseEvent]:
        """Decide whether the base is ready, and return the events of a change."""
        self._began_s = now if self._began_s is None else self._began_s
        problem = self._problem(now)
        if problem and self._ready:
            self._ready = False
            self._odometer.count_anew()
            return [Lost(problem)]
        if not problem and not self._ready:
            again = self._was_ready and self._odometer.restarts == self._known_restarts
            self._ready = self._was_ready = True
            self._known_restarts = self._odometer.restarts
            name = f"{self._description.name} on {self._line.endpoint}"
            return [Recovered() if again else Ready(name, self._description)]
        if problem and not self._was_ready and now - self._began_s > WAIT_S:
            return [Failed(f"{self._line.endpoint}: {problem}")]
        return []

    def _problem(self, now: float) -> str:
        """Return why the base is not ready; "" if it is."""
        if self._loop:
            return _LOOP
        where = self._line.topic(self._topics.odom)
        if self._odometer.publishers(now) > 1:
            who = self._announced.publisher_names(self._topics.odom)
            named = f": {' and '.join(who)}" if len(who) > 1 else ""
            self._contradictions[f"two publishers on {where}{named}"] = now
        recent = {reason: at for reason, at in self._contradictions.items() if now - at < CLEAR_S}
        self._contradictions = recent
        if recent:
            return next(iter(recent))
        if not self._ready:
            return self._other_type() if self._odometer.enough(now) else self._no_odometry(where, now)
        if self._odometer.restarts != self._known_restarts:
            return f"odometry on {where} began again: {self._odometer.restart_reason}"
        if self._odometer.age_s(now) <= LOSS_S:
            return ""
        return self._unused.words(self._topics.odom) or f"no odometry on {where} for {LOSS_S} s"

    def _no_odometry(self, where: str, now: float) -> str:
        topic = self._topics.odom
        if words := self._announced.type_problem(topic, ODOMETRY):
            return f"{where}: {words}"
        rate = self._odometer.rate_hz(now)
        if rate > 0:
            least = f"expected {MIN_IN_RATE / RATE_S:g} or more, evenly"
            return self._odometer.problem or f"odometry on {where} arrives {rate:.1f} times a second, {least}"
        return self._announced.instead_of_odometry(topic)

    def _other_type(self) -> str:
        """Return what is wrong with the type of ``cmd_vel``, as the robot announces it."""
        wanted = f"geometry_msgs/msg/{self._topics.cmd_vel_type}"
        if not (types := self._announced.other_type(self._topics.cmd_vel, wanted)):
            return ""
        where = self._line.topic(self._topics.cmd_vel)
        return f"the robot takes {types} on {where}: set topics.cmd_vel_type in the description, now {wanted}"

    def _send(self, velocity: Velocity, now: float) -> None:
        data = command(self._topics, velocity, self._odometer.robot_clock_ns(now))
        self._sent.append((now, data))
        self._out = velocity
        self._line.publish(data)
