"""The process beside the robot: one loop between a base and Zenoh.

Rules of this file:

1. One loop does it all: arrivals go to the session and the gate, the gate's verdict goes to the base.
   The base's keep-alives come from this loop, so a loop that hangs stops the rover.
2. Only the gate's verdict is sent to the base as a speed, and the same value is published.
3. Every exit stops the rover, switches its motors off and closes the session.
"""

import math
import time
from collections.abc import Callable, Iterator

from bridge.base_connection import Line
from bridge.gate.clearance import Clearance, Room
from bridge.gate.gate import step
from bridge.gate.limits import Limits
from bridge.gate.signatures import is_signed, read_tag
from bridge.gate.state import BaseLost, Command, Heard, Reason, State, Tick, Verdict
from bridge.gate.state import Event as GateEvent
from bridge.inbox import Arrival, Asked, Broken, Crashed, Inbox, Opened, Received, Sampled
from bridge.pioneer.events import (
    BaudChanged,
    Configured,
    Connected,
    Event,
    Failed,
    GyroHeard,
    Lost,
    Recovered,
    StateReceived,
)
from bridge.pioneer.odometry import BaseState
from bridge.pioneer.robots import RobotParameters
from bridge.pioneer.session import Session
from bridge.queries import Answers
from bridge.ros import messages as ros
from bridge.zenoh_link import Link
from rover_ncp.core.errors import FormatError, NoRobot
from rover_ncp.core.messages import read_twist, text
from rover_ncp.core.process import Clock
from rover_ncp.core.protocol import Signed, dump_json

TICK_S = 0.02
"""How often the loop turns when nothing arrives."""
APART_S = 0.01
"""Commands at a higher rate than this are not passed on one by one: a serial line could not carry them."""
STATUS_S = 0.1
SLOW_S = 1.0


class Node:
    """The loop and its state. ``say`` logs events for people; ``ready`` is called once."""

    def __init__(
        self,
        line: Line,
        link: Link,
        inbox: Inbox,
        session: Session,
        *,
        limits: Limits,
        accept_ros: bool,
        say: Callable[[str], None],
        ready: Callable[[], None],
        clock: Clock = time,
    ) -> None:
        self._clock = clock
        self._line, self._link, self._inbox, self._session = line, link, inbox, session
        self._limits, self._accept_ros, self._say = limits, accept_ros, say
        self._ready = ready
        self._answers = Answers(link, session, limits, self._judge)
        self.gate = State()
        self.reconnects = -1
        """Number of reconnections of the base; −1 until the first connection."""
        self._verdict = self._sent = Verdict(self.gate.out, motors=False, held=self.gate.held)
        self._base: BaseState | None = None
        self._robot: RobotParameters | None = None
        self._clearance: Clearance | None = None
        self._hardware = ""
        self._stopping = self._commanded = self._reopening = False
        self._unsaid: list[str] = []
        """Events of the gate to log after the base has got its commands."""
        self._look_at_the_wall_clock()
        self._acted_s = self._status_due_s = self._slow_due_s = -math.inf

    def run(self, stopping: Callable[[], bool]) -> None:
        """Serve until ``stopping``. Raises NoRobot if the base cannot be reached the first time."""
        try:
            while not stopping():
                self.turn()
        finally:
            self._session.close(self._clock.monotonic())
            self._line.write(self._session.data_to_send())
            self._line.close()
            self._say_news()

    @property
    def due_s(self) -> float:
        """When the loop turns even if nothing arrives."""
        return self._acted_s + TICK_S

    def turn(self) -> None:
        """Turn the loop once: take what arrived, at most one tick's wait for it, and act on it."""
        wait_s = max(self.due_s - self._clock.monotonic(), 0.0)
        for arrived_s, arrival in self._inbox.take(wait_s):
            self._take(arrival, arrived_s)
            # The base gets its setpoint in time, even when many messages have arrived.
            if (now := self._clock.monotonic()) - self._acted_s >= 2 * TICK_S:
                self._act(now)
                self._line.write(self._session.data_to_send())
        now = self._clock.monotonic()
        waited = now - self._acted_s
        if self._stopping or waited >= TICK_S or (self._commanded and waited >= APART_S):
            self._act(now)
        self._line.write(self._session.data_to_send())
        self._say_news()
        if now >= self._status_due_s:
            self._publish_gate(now)
        if now >= self._slow_due_s:
            self._publish_slowly(now)

    # What arrives.

    def _take(self, arrival: Arrival, arrived_s: float) -> None:
        match arrival:
            case Received(data):
                self._handle(self._session.receive(data, self._clock.monotonic()), arrived_s)
            case Sampled():
                self._judge(self._command(arrival), arrived_s)
            case Asked():
                self._answers.give(arrival, arrived_s, self.gate)
            case Opened(transport):
                self._line.use(transport)
                self._session.connect(self._clock.monotonic(), transport.baudrate)
            case Broken(error):
                if self.reconnects < 0:
                    raise error
                self._line.drop()
                self._handle(self._session.link_down(str(error), self._clock.monotonic()), arrived_s)
            case Crashed(error):
                raise error

    def _command(self, sample: Sampled) -> Command:
        """Read a command; the gate also gets commands that cannot be read, and drops them.

        Only the tag of a command without a valid signature is parsed.
        """
        tag = read_tag(sample.attachment)
        key = self._link.key("cmd_vel")
        signed = is_signed(tag, self.gate.lease, Signed.COMMAND, key, sample.payload)
        if not (signed or (tag is None and self._accept_ros)):
            return Command(None, tag)
        try:
            velocity, stamp_ns = read_twist(sample.payload)
        except FormatError:
            return Command(None, tag, signed=signed)
        sent_ns = stamp_ns if stamp_ns is not None else sample.sent_ns
        age_s = (self._clock.time_ns() - sent_ns) * 1e-9 if sent_ns is not None and tag is None else None
        return Command(velocity, tag, age_s, signed)

    def _handle(self, events: list[Event], arrived_s: float) -> None:
        for event in events:
            match event:
                case StateReceived(state):
                    self._base = state
                    assert self._clearance is not None  # a base is configured before it reports
                    self._judge(_heard(state, self._clearance.update(state.sonar, arrived_s)), arrived_s)
                    self._publish_sip(state, arrived_s)
                case GyroHeard(rate):
                    self._link.publish("imu", ros.turn(rate, self._wall_ns(arrived_s)))
                case Connected(name, robot_class, subtype):
                    self._hardware = f"{robot_class} {subtype} {name}"
                case Configured(_, robot):
                    self._robot, self._clearance = robot, Clearance(robot)
                    self._reopening = False
                    self.reconnects += 1
                    self._say(f"the base is there: {self._hardware}")
                    if self.reconnects == 0:
                        self._ready()
                case BaudChanged(baudrate):
                    self._line.set_baudrate(baudrate)
                case Recovered():
                    self._say("the base sends packets again")
                case Lost(reason):
                    self._base = None
                    self._judge(BaseLost(), arrived_s)
                    self._say(f"the base is lost: {reason}")
                case Failed(reason):
                    if self.reconnects < 0:
                        raise NoRobot(f"{self._line.endpoint}: {reason}")
                    if not self._reopening:
                        self._say(
                            f"{self._line.endpoint}: {reason}; the bridge closes and reopens the line until "
                            "the base answers: check its power, its cable or its network"
                        )
                    self._reopening = True
                    self._line.reopen(reason)

    def _judge(self, event: GateEvent, now: float) -> Verdict:
        """Pass an event through the gate."""
        before = self.gate
        self.gate, self._verdict = step(before, event, now, self._limits, self._accept_ros)
        # Neither a stop nor a command that counts waits for the next tick.
        self._stopping |= self._verdict.held is not None and before.held is None
        self._commanded |= self.gate.accepted > before.accepted
        if _public(self.gate) != _public(before):
            self._status_due_s = -math.inf
            self._unsaid += _news(before, self.gate)
        return self._verdict

    def _say_news(self) -> None:
        for line in self._unsaid:
            self._say(line)
        self._unsaid.clear()

    # What follows from it.

    def _act(self, now: float) -> None:
        """Pass the gate's verdict to the session. Its tick sends the setpoint and the keep-alives."""
        verdict = self._judge(Tick(), now)
        last, self._sent = self._sent, verdict
        self._stopping = self._commanded = False
        self._acted_s = now
        if verdict.motors != last.motors:
            self._session.enable(verdict.motors)
        if verdict.emergency and not last.emergency:
            self._session.emergency_stop()
        self._session.set_motion(*verdict.velocity)
        self._handle(self._session.tick(now), now)
        if verdict.velocity != last.velocity:
            self._link.publish("rover/cmd_out", ros.velocity(verdict.velocity, self._wall_ns(now)))

    def _publish_sip(self, state: BaseState, arrived_s: float) -> None:
        assert self._robot is not None  # a base is configured before it reports
        stamp_ns = self._wall_ns(arrived_s)
        for name, data in ros.each_sip(state, self._robot, stamp_ns).items():
            self._link.publish(name, data)
        self._link.publish("rover/cmd_out", ros.velocity(self._sent.velocity, stamp_ns))

    def _publish_gate(self, now: float) -> None:
        self._status_due_s = now + STATUS_S
        self._link.publish("rover/gate", text(dump_json(ros.gate_status(self.gate)).decode()))

    def _publish_slowly(self, now: float) -> None:
        self._slow_due_s = now + SLOW_S
        self._look_at_the_wall_clock()
        stamp_ns = self._wall_ns(now)
        health = ros.diagnostics(
            self._base,
            self.gate,
            self._session.decoder,
            reconnects=max(self.reconnects, 0),
            hardware=self._hardware,
            stamp_ns=stamp_ns,
        )
        self._link.publish("diagnostics", health)
        if self._base is not None and self._robot is not None:
            for name, data in ros.each_so_often(self._base, self._robot, stamp_ns).items():
                self._link.publish(name, data)

    def _wall_ns(self, monotonic_s: float) -> int:
        """Return the time of a moment on the monotonic clock, in ns since the epoch."""
        return self._epoch_ns + round(monotonic_s * 1e9)

    def _look_at_the_wall_clock(self) -> None:
        """Set the stamps to the wall clock again, unless a driver holds the lease.

        A driver would take samples whose stamps step back for samples that were delayed by that much.
        """
        if self.gate.lease is None:
            self._epoch_ns = self._clock.time_ns() - self._clock.monotonic_ns()


def _heard(state: BaseState, room: Room) -> Heard:
    return Heard(
        x=state.x,
        y=state.y,
        theta=state.theta,
        v=state.v,
        omega=state.omega,
        battery_v=state.battery_v,
        motors_on=state.motors_enabled,
        stop_pressed=state.stop_pressed,
        stalled=any(state.stalled),
        bumped=any(state.bumpers),
        clear_ahead_m=room.ahead_m,
        clear_behind_m=room.behind_m,
    )


def _public(gate: State) -> tuple[object, ...]:
    """Return the fields whose change is published at once."""
    return gate.lease.number if gate.lease else None, gate.held, gate.ended, gate.latched


def _news(before: State, after: State) -> Iterator[str]:
    """Yield log lines: the driver that holds the lease, and the reason for a stop."""
    old, new = before.lease, after.lease
    if new is not None and (old is None or old.number != new.number):
        yield f"{new.name or 'a driver without a name'} got the lease"
    if old is not None and new is None:
        yield f"{old.name or 'a driver without a name'} " + (
            f"lost the lease: {after.ended}" if after.ended else "released the lease"
        )
    if before.held is None and after.held not in {None, Reason.NO_LEASE}:
        yield f"stopped: {after.held}"
