"""The process beside the robot: one loop between a base and Zenoh.

Rules of this file:

1. One loop does it all: arrivals go to the base and the gate, the gate's verdict goes to the base.
   The base's keep-alives come from this loop, so a loop that hangs stops the rover.
2. Only the gate's verdict is sent to the base as a speed, and the same value is published.
3. Every exit stops the rover, switches its motors off and closes the connection. It does not rely on the
   base's `close` for that. An exception of the base is such an exit.
"""

import logging
import math
import time
from collections.abc import Callable, Iterator, Sequence

from pydantic import BaseModel, Field

from bridge import base_messages as ros
from bridge.base import (
    Base,
    BaseEvent,
    BaseReport,
    Failed,
    Lost,
    Notice,
    PassedOn,
    Ready,
    Recovered,
    Setpoint,
    TurnRate,
    base_failures,
)
from bridge.gate.gate import step
from bridge.gate.limits import Limits
from bridge.gate.state import (
    AT_THE_ROBOT,
    BaseLost,
    GateEvent,
    GateState,
    Reason,
    Tick,
    VelocityCommand,
    Verdict,
    describe,
    read_tag,
)
from bridge.inbox import CommandMessage, Query, ThreadError
from bridge.queries import Answers
from rover_ncp.core.bridge_lines import (
    BACK,
    CONNECTED,
    GOT_LEASE,
    HAZARD,
    LOST,
    LOST_LEASE,
    RELEASED_LEASE,
    STOPPED,
)
from rover_ncp.core.errors import FormatError, NoRobot, SafetyStop
from rover_ncp.core.geometry import STANDSTILL
from rover_ncp.core.process import Clock, suspended_s
from rover_ncp.robot.description import RobotDescription
from rover_ncp.wire.messages import read_twist, text, twist_stamped
from rover_ncp.wire.protocol import REASONS, Signed, dump_json

_LOGGER = logging.getLogger("rover_ncp")
TICK_S = 0.02
"""How often the loop turns when nothing arrives."""
APART_S = 0.01
"""Commands at a higher rate than this are not passed on one by one: a serial line could not carry them."""
FLICKER_S = 1.0
"""A hazard that comes again within this time is the same one."""
MAX_LOG_LINES = 20
"""Lines of requests that are logged in a second: a flood of them must not fill the log."""
SUSPENDED_S = 0.1
"""A suspend of the computer for longer than this ends the lease."""
STATUS_S = 0.1
NAMELESS = "a driver without a name"
SLOW_S = 1.0


class BridgeResult(BaseModel):
    """Result of the command ``bridge``."""

    zenoh: str = Field(description="the locator for drivers")
    base: str = Field(description="its address")
    accepted: int = Field(description="commands that the gate passed")
    dropped: dict[str, int] = Field(description="commands, by reason")
    limited: dict[str, int] = Field(description="commands, by reason")
    stops: dict[str, int] = Field(description="by reason")
    reconnects: int = Field(description="to the base")
    flooded: int = Field(description="messages dropped because too many of their key or topic waited")


class Node:
    """The loop and its state; ``ready`` is called once.

    ``take`` is that of an `Inbox`; ``key`` and ``publish`` are those of the drivers' `ZenohLink`.
    """

    def __init__(
        self,
        base: Base,
        take: Callable[[float], list[tuple[float, object]]],
        *,
        key: Callable[[str], str],
        publish: Callable[[str, bytes], None],
        limits: Limits,
        ready: Callable[[], None],
        clock: Clock = time,
        suspended_s: Callable[[], float] = suspended_s,
    ) -> None:
        self._base, self._arrivals, self._clock = base, take, clock
        self._key, self._publish = key, publish
        self._total_suspended_s, self._suspended_s = suspended_s, suspended_s()
        self._limits, self._ready = limits, ready
        self._log: list[str] = []
        """Events to log after the base has got its setpoint."""
        self._requests = 0
        """Lines of requests since `_publish_slowly`."""
        self._hazards_s: dict[Reason, float] = {}
        """When each hazard came last while no driver held the lease."""
        self._answers = Answers(
            *(limits, key, self.judge, self._base), wall_ns=self._wall_ns, log=self._log_request
        )
        self.gate = GateState()
        self.reconnects = -1
        """Number of reconnections of the base; −1 until the first connection."""
        self._verdict = self._sent = Verdict(self.gate.out, motors=False, held=self.gate.held)
        self._report: BaseReport | None = None
        self._robot: RobotDescription | None = None
        self._variances: ros.Variances | None = None
        self._hardware, self._early = "", False
        self._act_now = self._commanded = False
        self._set_wall_clock()
        self._acted_s = self._status_due_s = self._slow_due_s = -math.inf

    def run(self, stopping: Callable[[], bool]) -> None:
        """Serve until ``stopping``.

        Raises NoRobot if the base cannot be reached the first time, or fails. With a fence, a failure is a
        SafetyStop: after a restart the fence would be in another place.
        """
        try:
            while not stopping():
                self.run_once()
        except NoRobot as error:
            if self.reconnects < 0 or self._limits.fence is None:
                raise
            words = f"{error}; put the rover where the fence begins, then start the bridge"
            raise SafetyStop(str(Reason.FENCE_LOST), words) from error
        finally:
            self._shut_down_base(self._clock.monotonic())
            self._flush_log()

    def _shut_down_base(self, now: float) -> None:
        """Stop the base, switch its motors off, then close it; log what fails."""
        stop = Setpoint(STANDSTILL, motors=False, emergency=False)
        for call in (lambda: list(self._base.drive(stop, now)), lambda: self._base.close(now)):
            try:
                with base_failures():
                    call()
            except NoRobot as error:
                self._log.append(str(error))

    @property
    def report(self) -> BaseReport | None:
        """The newest report of the base; None while it is lost."""
        return self._report

    @property
    def due_s(self) -> float:
        """When the loop turns even if nothing arrives."""
        return self._acted_s + TICK_S

    def run_once(self) -> None:
        """Turn the loop once: take what arrived, at most one tick's wait for it, and act on it."""
        wait_s = max(self.due_s - self._clock.monotonic(), 0.0)
        for arrived_s, arrival in self._arrivals(wait_s):
            self._take(arrival, arrived_s)
            # The base gets its setpoint in time, even when many messages have arrived.
            if (now := self._clock.monotonic()) - self._acted_s >= 2 * TICK_S:
                self._act(now)
        now = self._clock.monotonic()
        waited = now - self._acted_s
        if self._act_now or waited >= TICK_S or (self._commanded and waited >= APART_S):
            self._act(now)
        self._flush_log()
        if now >= self._status_due_s:
            self._status_due_s = now + STATUS_S
            status = ros.gate_status(self.gate, self._limits.fence)
            self._publish("rover/gate", text(dump_json(status).decode()))
        if now >= self._slow_due_s:
            self._publish_slowly(now)

    # What arrives.

    def _take(self, arrival: object, arrived_s: float) -> None:
        match arrival:
            case CommandMessage():
                self.judge(self._command(arrival), arrived_s)
            case Query():
                self._answers.give(arrival, arrived_s, self.gate)
            case ThreadError(error):
                raise error
            case _:
                with base_failures():
                    events = list(self._base.receive(arrival, self._clock.monotonic()))
                self._handle(events, arrived_s)

    def _command(self, message: CommandMessage) -> VelocityCommand:
        """Read a command; the gate also gets commands that cannot be read, and drops them.

        Only the tag of a command without a valid signature is parsed.
        """
        tag, lease = read_tag(message.attachment), self.gate.lease
        key = self._key("cmd_vel")
        if lease is None or not lease.signed(tag, Signed.COMMAND, key, message.payload):
            return VelocityCommand(None, tag)
        try:
            velocity, _ = read_twist(message.payload)
        except FormatError:
            return VelocityCommand(None, tag, signed=True)
        return VelocityCommand(velocity, tag, signed=True)

    def _handle(self, events: Sequence[BaseEvent], arrived_s: float) -> None:
        for event in events:
            match event:
                case BaseReport():
                    self._take_report(event, arrived_s)
                case TurnRate(rate, age_s) if self._robot is not None:
                    stamp_ns = self._wall_ns(arrived_s - age_s)
                    self._publish("imu", ros.turn_rate(rate, self._robot, stamp_ns))
                case PassedOn(key, data):
                    self._publish(key, data)
                case Ready(hardware, robot):
                    self._hardware, self._robot = hardware, robot
                    self._variances = ros.odometry_variances(robot)
                    self._limits = self._answers.limits = self._limits.within(robot)
                    self._answers.model, self._answers.problem = robot.name, ""
                    self.reconnects += 1
                    if self.reconnects > 0:
                        self.judge(BaseLost("its odometry restarted", restarted=True), arrived_s)
                    _LOGGER.info(f"{CONNECTED}{hardware}")
                    if self.reconnects == 0:
                        self._ready()
                case Recovered():
                    self._answers.problem = ""
                    _LOGGER.info(BACK)
                case Notice(words):
                    _LOGGER.info(words)
                case Lost(reason):
                    self._report, self._answers.problem = None, reason
                    self.judge(BaseLost(reason), arrived_s)
                    _LOGGER.info(f"{LOST}{reason}")
                case Failed(reason):
                    if self.reconnects < 0:
                        raise NoRobot(reason)
                    _LOGGER.info(
                        f"{reason}; the bridge closes and reopens the line until the base answers: "
                        "check its power, its cable or its network"
                    )

    def judge(self, event: GateEvent, now: float) -> Verdict:
        """Pass an event through the gate."""
        before = self.gate
        self.gate, self._verdict = step(before, event, now, self._limits)
        # Neither a stop nor an accepted command waits for the next tick.
        self._act_now |= self._verdict.held is not None and before.held is None
        self._commanded |= self.gate.accepted > before.accepted
        if _public(self.gate) != _public(before):
            self._status_due_s = -math.inf
            self._log += _log_lines(before, self.gate)
            if (hazard := _hazard_without_lease(before, self.gate)) is not None:
                self._log_hazard(hazard, now)
        return self._verdict

    def _log_hazard(self, hazard: Reason, now: float) -> None:
        """Log a hazard, unless it was active a moment ago, as a loose contact makes it."""
        if now - self._hazards_s.get(hazard, -math.inf) >= FLICKER_S:
            self._log.append(f"{HAZARD}{_in_words(hazard, self.gate)}")
        self._hazards_s[hazard] = now

    def _log_request(self, line: str) -> None:
        self._requests += 1
        if self._requests <= MAX_LOG_LINES:
            self._log.append(line)

    def _flush_log(self) -> None:
        for line in self._log:
            _LOGGER.info(line)
        self._log.clear()

    # What follows from it.

    def _act(self, now: float) -> None:
        """Pass the gate's verdict to the base, which also sends its keep-alives then."""
        self._end_lease_after_suspend(now)
        verdict = self.judge(Tick(), now)
        last, self._sent = self._sent, verdict
        self._act_now = self._commanded = False
        self._acted_s = now
        lease = verdict.lease.number if verdict.lease else 0
        setpoint = Setpoint(verdict.velocity, verdict.motors, verdict.emergency, lease)
        with base_failures():
            events = list(self._base.drive(setpoint, now))
        self._handle(events, now)
        if verdict.velocity != last.velocity:
            self._publish("rover/cmd_out", twist_stamped(verdict.velocity, self._wall_ns(now)))

    def _end_lease_after_suspend(self, now: float) -> None:
        """End the lease after a suspend: the monotonic clock stood still, so old commands look fresh."""
        slept_s = self._total_suspended_s() - self._suspended_s
        if slept_s > SUSPENDED_S:
            words = f"this computer was suspended for {slept_s:.1f} s"
            self.judge(BaseLost(words), now)
            self._log.append(words)
        self._suspended_s += max(slept_s, 0.0)

    def _take_report(self, report: BaseReport, arrived_s: float) -> None:
        """Pass a report to the gate and publish it."""
        if self._robot is None or self._variances is None:
            if not self._early:
                _LOGGER.warning("the base reports before it is ready: these reports are not used")
            self._early = True
            return
        self._report = report
        self.judge(report, arrived_s)
        stamp_ns = self._wall_ns(arrived_s - report.age_s)
        for name, data in ros.each_report(report, self._robot, stamp_ns, self._variances).items():
            self._publish(name, data)
        self._publish("rover/cmd_out", twist_stamped(self._sent.velocity, self._wall_ns(arrived_s)))

    def _publish_slowly(self, now: float) -> None:
        self._slow_due_s = now + SLOW_S
        if self._requests > MAX_LOG_LINES:
            self._log.append(f"{self._requests - MAX_LOG_LINES} more requests came")
        self._requests = 0
        self._set_wall_clock()
        stamp_ns = self._wall_ns(now)
        with base_failures():
            line = self._base.health()
        health = ros.diagnostics(
            self._report,
            self.gate,
            line,
            reconnects=max(self.reconnects, 0),
            hardware=self._hardware,
            stamp_ns=stamp_ns,
        )
        self._publish("diagnostics", health)
        if self._report is not None and self._robot is not None:
            for name, data in ros.each_second(self._report, self._robot, stamp_ns).items():
                self._publish(name, data)

    def _wall_ns(self, monotonic_s: float) -> int:
        """Return the time of a moment on the monotonic clock, in ns since the epoch."""
        return self._epoch_ns + round(monotonic_s * 1e9)

    def _set_wall_clock(self) -> None:
        """Set the stamps to the wall clock again, unless a driver holds the lease.

        A driver would take samples whose stamps step back for samples that were delayed by that much.
        """
        if self.gate.lease is None:
            self._epoch_ns = self._clock.time_ns() - self._clock.monotonic_ns()


def _public(gate: GateState) -> tuple[object, ...]:
    """Return the fields whose change is published at once."""
    return gate.lease.number if gate.lease else None, gate.held, gate.lease_over, gate.stop_reason


def _log_lines(before: GateState, after: GateState) -> Iterator[str]:
    """Yield the log's lines: the driver that holds the lease, and the reason for a stop."""
    old, new = before.lease, after.lease
    if new is not None and (old is None or old.number != new.number):
        yield f"{new.name or NAMELESS}{GOT_LEASE}"
    if old is not None and new is None:
        yield (old.name or NAMELESS) + (
            f"{LOST_LEASE}{after.lease_over}, {after.lease_over_detail}"
            if after.lease_over
            else RELEASED_LEASE
        )
    if before.held is None and after.held is not None and after.held is not Reason.NO_LEASE:
        yield f"{STOPPED}{_in_words(after.held, after)}"


def _hazard_without_lease(before: GateState, after: GateState) -> Reason | None:
    """Return the hazard that the base began to report while no driver held the lease, if any."""
    began = after.held in AT_THE_ROBOT and after.held is not before.held
    return after.held if began and before.lease is None and after.lease is None else None


def _in_words(reason: Reason, gate: GateState) -> str:
    words = describe(reason, gate)
    return f"{reason}" + (f": {words}" if words != REASONS.get(reason) else "")
