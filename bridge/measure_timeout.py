"""Measurement of a ROS 2 robot's own command timeout, before the bridge serves a driver.

The robot is driven through the gate under a lease that no driver outside this process can get. Every end
sends zeros.
"""

import math
import secrets
from collections.abc import Callable
from datetime import date

from pydantic import BaseModel, Field

from bridge.gate.limits import Limits
from bridge.gate.state import Enable, Reason, VelocityCommand, describe
from bridge.inbox import Inbox
from bridge.node import Node
from bridge.ros2.base import WAIT_S, Ros2Base
from bridge.ros2.base_timeout import MAX_SILENT_S, SPEED_M_S, Phase, TimeoutMeasurement
from rover_ncp.core.errors import NoRobot, SafetyStop
from rover_ncp.core.process import Clock
from rover_ncp.robot.description import MAX_BASE_TIMEOUT_S
from rover_ncp.wire.protocol import KEY_BYTES, CommandTag

NAME = "bridge --measure-timeout"
COMMAND_S = 0.05


class TimeoutResult(BaseModel):
    """Result of ``bridge --measure-timeout``."""

    timeout_s: float | None = Field(description="from the last command to the halt; null: it did not halt")
    line: str = Field(description="for the robot's description; empty if the robot must not be driven by it")


def measure(
    base: Ros2Base,
    inbox: Inbox,
    limits: Limits,
    stopping: Callable[[], bool],
    *,
    begins: Callable[[], None],
    clock: Clock,
    total_suspended_s: Callable[[], float],
) -> TimeoutResult:
    """Drive a robot forward for 1.5 s, send it nothing, and measure when it halts.

    ``begins`` is called when the robot gets its first command. Raises NoRobot, SafetyStop if the gate holds
    the robot or it does not move, and KeyboardInterrupt when ``stopping`` becomes true. The robot gets zeros
    at each end.
    """
    node = Node(
        base,
        inbox.take,
        key=str,
        publish=lambda name, data: None,  # there are no drivers
        limits=limits,
        ready=lambda: None,
        clock=clock,
        suspended_s=total_suspended_s,
    )
    run = _Run(node, base, limits, begins, clock)
    node.run(lambda: stopping() or run.step())
    if run.measurement.phase is Phase.DRIVES_ON:
        return TimeoutResult(timeout_s=None, line="")
    if run.measurement.phase is not Phase.HALTED:
        raise KeyboardInterrupt
    timeout_s = math.ceil(100.0 * run.measurement.timeout_s) / 100.0
    line = f"measured_base_timeout_s: {timeout_s:g} # {date.today()}"
    return TimeoutResult(timeout_s=timeout_s, line=line if timeout_s <= MAX_BASE_TIMEOUT_S else "")


def words_for(result: TimeoutResult) -> str:
    """Return a result in words."""
    unsafe = "if the bridge dies, it drives on: only 'bridge --no-base-watchdog' serves it"
    if result.timeout_s is None:
        return f"the robot did not halt within {MAX_SILENT_S:g} s without commands; {unsafe}"
    if not result.line:
        after = f"the robot halts {result.timeout_s:g} s after its last command"
        return f"{after}, expected at most {MAX_BASE_TIMEOUT_S:g} s; {unsafe}"
    return (
        "this is by the robot's odometry, which looks the same if it freezes when the commands stop: only if "
        "the wheels stood too, add this line to robot.yaml, then start the bridge:\n"
        f"{result.line}"
    )


class _Run:
    """The driver of one measurement; a turn of the node's loop calls `step` once."""

    def __init__(
        self, node: Node, base: Ros2Base, limits: Limits, begins: Callable[[], None], clock: Clock
    ) -> None:
        self._node, self._base, self._begins, self._clock = node, base, begins, clock
        self._ready_s: float | None = None
        self._speed, self._mean_s = min(SPEED_M_S, limits.v_max), limits.speed_mean_s
        self.measurement = TimeoutMeasurement(clock.monotonic(), self._speed, self._mean_s)
        self._lease, self._sequence, self._sent_s = 0, 0, -math.inf
        self._seen = node.report

    def step(self) -> bool:
        """Send what is due, and return whether the measurement is over. Raises SafetyStop or NoRobot."""
        now, gate, measurement = self._clock.monotonic(), self._node.gate, self.measurement
        if not self._lease:
            if self._node.reconnects >= 0:
                self._begin(now)
            return False
        if self._sequence and gate.held is not None:  # zeros were sent, so what follows says nothing
            reason = gate.lease_over or gate.held
            words = gate.lease_over_detail or describe(reason, gate) or reason
            raise SafetyStop(str(reason), f"the timeout was not measured: {words}")
        if self._node.report is not self._seen and self._node.report is not None:
            self._seen = self._node.report
            measurement.take(self._seen, now)
        measurement.tick(now, self._base.last_sent_s)
        if measurement.phase is Phase.NO_MOTION:
            raise SafetyStop("no-response", f"the robot does not follow {self._speed:g} m/s by its odometry")
        self._base.silent = measurement.phase is Phase.SILENT
        if measurement.phase not in {Phase.DRIVE, Phase.SILENT}:
            return True
        if now - self._sent_s >= COMMAND_S:
            self._sequence, self._sent_s = self._sequence + 1, now
            tag = CommandTag(self._lease, self._sequence, round(now * 1e9))
            self._node.judge(VelocityCommand(measurement.command, tag, signed=True), now)
        return False

    def _begin(self, now: float) -> None:
        self._ready_s = now if self._ready_s is None else self._ready_s
        waits = now - self._ready_s <= WAIT_S
        if self._node.report is None:
            if waits:
                return
            raise NoRobot(f"the robot was lost before it was driven: {self._node.gate.lost or 'no odometry'}")
        verdict = self._node.judge(Enable(NAME, round(now * 1e9), secrets.token_bytes(KEY_BYTES)), now)
        if verdict.refusal is Reason.HAZARD_UNKNOWN and waits:  # its topic may send seldom
            return
        if verdict.refusal is not None:
            raise SafetyStop(str(verdict.refusal), describe(verdict.refusal, self._node.gate))
        assert verdict.lease is not None  # it was granted
        self._lease = verdict.lease.number
        self._begins()
        self.measurement = TimeoutMeasurement(now, self._speed, self._mean_s)
