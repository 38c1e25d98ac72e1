"""Pre-flight check of a robot on blocks: sensors, direction of motion, stop without commands.

Each check returns whether it passed, and its finding. The first that fails ends the list: later ones would
fail for the same cause. The wheels move at walking pace for a few seconds.
"""

import math
import time
from collections.abc import Callable
from datetime import date

from pydantic import BaseModel, Field

from deploy.drive.dead_zone import DeadZone
from deploy.drive.measurements import Measurement, Measurements
from deploy.drive.safety_monitor import SafetyMonitor
from deploy.drive.signed_lease import ACCEPTED_S, NOT_ACCEPTED
from deploy.drive.zenoh_link import ZenohLink
from deploy.identify.excitation import ramps
from deploy.publishers import INPUTS, Publishers
from deploy.zenoh_client import BridgeAddress
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.errors import FormatError, RoverNcpError, SafetyStop
from rover_ncp.core.geometry import Velocity, relative
from rover_ncp.core.process import Clock, Interrupts
from rover_ncp.recording.recording import Recorded
from rover_ncp.robot.description import RobotDescription
from rover_ncp.wire.cdr import decode
from rover_ncp.wire.messages import OdometrySample
from rover_ncp.wire.protocol import GateStatus, TimeoutState

V_M_S, OMEGA_RAD_S = 0.1, 0.2
"""Slow, and still well above the noise of wheels in the air."""
MOVE_S, PERIOD_S = 1.5, 0.05
RATE_HZ, LISTEN_S = 8.0, 2.0
"""A base reports ten times a second; with fewer than eight, packets are lost."""
ATTEMPTS = 2
"""A second attempt, because a stall of this computer is no fault of the robot."""
RATE_SHARE, MAX_HZ = 0.8, 50.0
"""Share of a described rate; a bridge passes on 50 reports a second at most."""
BATTERY_SHARE, BATTERY_WAIT_S = 11.5 / 11.0, 2.0
"""Of the voltage at which the gate stops, so that a drive ends before it; a Pioneer's alarm level."""
STOP_S = 0.5
"""The first safety requirement; braking and the time to the next report come on top."""
BRAKING_S, REPORT_S = 0.15 + V_M_S / 0.3, 0.1
MEASURE_TRIES = 3
"""The gate may have stopped the wheels before a delayed request arrives."""
MEASURING_S, POLL_S = 8.0, 0.2
"""The bridge sends the base nothing for 5 s at most."""
SCALE = 0.15
"""How far the distance by the pose and the distance by the speed may differ, as a share."""
STANDING = 0.01
_NO_REPLY = "the bridge does not report its base"
MAX_BAND = Velocity(0.05, 0.26)
"""Largest dead bands of simulated robots that parked in 9 of 10 trials; with 0.06 and 0.28 it was 6 of 10."""
UNKNOWN_BAND = Velocity(0.02, 0.06)
"""Dead band that a driver need not know, with the resolution of the measurement."""


class Finding(BaseModel):
    """Result of one check."""

    name: str = Field(description="of the check")
    ok: bool = Field(description="whether it passed")
    detail: str = Field(description="in words")


class CheckResult(BaseModel):
    """Result of all checks."""

    ready: bool = Field(description="whether all checks passed")
    findings: list[Finding] = Field(description="the result of each check")
    robot: str = Field(description="the bridge's Zenoh address")


def run(address: BridgeAddress, robot: RobotDescription | None = None) -> CheckResult:
    """Check a robot, against its description if there is one. Raises NoBridge, NotAuthorised."""
    battery = Battery()
    with Interrupts() as interrupts, ZenohLink(address, battery.record) as link:
        measurements = Measurements(link)
        monitor = SafetyMonitor(link, measurements, lambda: interrupts.raised)
        monitor.wait_for_bridge()
        publishers = Publishers()
        link.listen(INPUTS, publishers.note)
        findings = Preflight(link, measurements, monitor, battery, publishers, robot=robot).run()
        ready = all(finding.ok for finding in findings)
        return CheckResult(ready=ready, findings=findings, robot=link.robot)


class Battery:
    """The newest battery voltage (V) among the link's messages: 0 if it is not known, NaN without one."""

    voltage = math.nan

    def record(self, message: Recorded) -> None:
        """Read a message, as the link's recorder."""
        if message.topic == "battery_state":
            try:
                volts = decode(message.type, message.data).voltage
                self.voltage = volts if math.isfinite(volts) else 0.0
            except FormatError:
                self.voltage = math.nan


class Preflight:
    """Checks one robot. At every end, the lease is released."""

    def __init__(
        self,
        link: ZenohLink,
        measurements: Measurements,
        monitor: SafetyMonitor,
        battery: Battery,
        publishers: Publishers | None = None,
        *,
        robot: RobotDescription | None = None,
        clock: Clock = time,
    ) -> None:
        self._link, self._measurements, self._robot = link, measurements, robot
        self._monitor, self._battery, self._clock = monitor, battery, clock
        self._publishers = publishers or Publishers()

    def run(self) -> list[Finding]:
        """Run all checks, in this order. Raises KeyboardInterrupt after a termination signal."""
        findings: list[Finding] = []
        checks = {
            **({"model": self._check_model} if self._robot else {}),
            "odometry": self._check_inputs,
            "battery": self._check_battery,
            "stop": self._check_holds,
            "motors": self._check_motors,
            "forward": self._check_forward,
            "left": self._check_left,
            "slow": self._check_slow,
            "silence": self._check_silence,
            "bridge": self._check_base_timeout,
        }
        try:
            for name, check in checks.items():
                gate = self._link.gate
                try:
                    ok, detail = check()
                except SafetyStop as stop:  # the gate accepts no more commands
                    ok, detail = False, f"{stop}: {self._gate_since(gate)}"
                findings.append(Finding(name=name, ok=ok, detail=detail))
                if not ok:
                    break
        finally:
            self._link.release()
        return findings

    def _check_model(self) -> tuple[bool, str]:
        assert self._robot is not None
        base = self._link.about_base()
        found = base.model if base else "a robot without a name"
        return found == self._robot.name, f"the bridge drives {found}, expected {self._robot.name}"

    def _check_inputs(self) -> tuple[bool, str]:
        ok, words = self._check_odometry()
        problems = list(self._publishers.problems(self._link.namespace))
        keep_out = "keep others out with 'rover-ncp keys'"
        return (False, f"{'; '.join(problems)}: {keep_out}") if ok and problems else (ok, words)

    def _check_odometry(self) -> tuple[bool, str]:
        minimum, rate = RATE_HZ, 0.0
        if self._robot is not None:
            minimum = RATE_SHARE * min(self._robot.odometry.rate_hz, MAX_HZ)
        for _ in range(ATTEMPTS):
            before = self._measurements.taken["odom"]
            self._until(lambda: False, LISTEN_S)
            rate = (self._measurements.taken["odom"] - before) / LISTEN_S
            if rate >= minimum:
                break
        return rate >= minimum, f"{rate:.1f} reports a second (at least {minimum:g})"

    def _check_battery(self) -> tuple[bool, str]:
        base = self._link.about_base()
        if base is None:
            return False, _NO_REPLY
        minimum = BATTERY_SHARE * (base.battery_min_v or 0.0)
        self._until(lambda: math.isfinite(self._battery.voltage), BATTERY_WAIT_S)
        volts = self._battery.voltage
        if volts <= 0.0:  # as to the gate
            return True, "the base reports no voltage"
        return volts >= minimum, f"{volts:.1f} V (at least {minimum:.1f} V)"

    def _check_holds(self) -> tuple[bool, str]:
        base, gate = self._link.about_base(), self._link.gate
        if base is not None and base.silent:
            words = f"no message has come on {' and '.join(base.silent)}: what it reports would stop nothing"
            return False, words
        holder = gate.driver_name or ("a driver without a name" if gate.lease else gate.held)
        return not holder, f"held by {holder}" if holder else "nothing holds the rover"

    def _check_motors(self) -> tuple[bool, str]:
        try:
            began = self._clock.monotonic()
            self._link.request_motors("check", unchecked=True)
        except RoverNcpError as error:
            return False, str(error)
        return True, f"granted within {self._clock.monotonic() - began:.3f} s"

    def _check_forward(self) -> tuple[bool, str]:
        gate = self._link.gate
        before, after, by_speed = self._move(Velocity(V_M_S, 0.0))
        ahead = relative(before.pose, after.pose).x
        if after.velocity.v <= 0.5 * V_M_S or ahead <= 0.0:
            moved = f"commanded {V_M_S} m/s, the base reports {after.velocity.v:.2f} m/s and {ahead:.2f} m"
            return False, f"{moved}: {self._gate_since(gate)}"
        words = f"{ahead:.3f} m by its pose, {by_speed:.3f} m by its speed"
        if self._speed_mean_s:
            return True, f"{words}, which is a mean over {self._speed_mean_s:g} s"
        return abs(ahead - by_speed) <= SCALE * by_speed, words

    def _check_left(self) -> tuple[bool, str]:
        gate = self._link.gate
        before, after, _ = self._move(Velocity(0.0, OMEGA_RAD_S))
        turned = relative(before.pose, after.pose).theta
        ok = after.velocity.omega > 0.5 * OMEGA_RAD_S and turned > 0.0
        reported = f"{after.velocity.omega:.2f} rad/s and {turned:.2f} rad"
        moved = f"commanded {OMEGA_RAD_S} rad/s, the base reports {reported}"
        return ok, moved if ok else f"{moved}: {self._gate_since(gate)}"

    def _check_slow(self) -> tuple[bool, str]:
        """Measure the dead band; a driver must know a large one."""
        found = [0.0, 0.0]
        for step in ramps(self._measurements):
            self._command(step.velocity, step.seconds)
            found = [speed or before for speed, before in zip(step.velocity, found, strict=True)]
        words = f"follows commands from {found[0]:.3g} m/s and {found[1]:.3g} rad/s on"
        if found[0] > 1.01 * MAX_BAND.v or found[1] > 1.01 * MAX_BAND.omega:  # steps have rounding errors
            most = f"{MAX_BAND.v:g} m/s and {MAX_BAND.omega:g} rad/s"
            return (
                False,
                f"{words}, expected from {most} on at most: a policy cannot park with this dead band",
            )
        known = DeadZone(described=self._robot).band
        if found[0] <= known.v + UNKNOWN_BAND.v and found[1] <= known.omega + UNKNOWN_BAND.omega:
            return True, words
        line = f"motion.dead_band: {{v: {found[0]:.3g}, omega: {found[1]:.3g}}}"
        return False, f"{words}, the driver does not know of it; for the robot's description: {line}"

    def _check_silence(self) -> tuple[bool, str]:
        """Test the stop when no more commands arrive."""
        self._move(Velocity(V_M_S, 0.0))
        silent = self._clock.monotonic()
        braking_s = BRAKING_S
        if self._robot is not None:
            braking_s = max(braking_s, self._robot.delays.v_s + V_M_S / self._robot.motion.decel)
        allowed = STOP_S + braking_s + REPORT_S
        stands = self._until(self._stands, 2 * allowed + self._speed_mean_s)
        # A stall of this process does not count, and mean speeds end later than the motion.
        took = self._newest.ref.measured_ns / NS_PER_S - silent - self._speed_mean_s
        words = f"stands {took:.2f} s after the last command" if stands else "does not stop"
        return stands and took <= allowed, f"{words} (at most {allowed:.2f} s)"

    def _check_base_timeout(self) -> tuple[bool, str]:
        """Test the base's own stop: the bridge sends it nothing, as if the bridge had died."""
        base = self._link.about_base()
        if base is None:
            return False, _NO_REPLY
        if base.state is TimeoutState.PUBLISHED:
            return True, f"if the bridge dies, the base halts after {base.timeout_s:g} s, as it says itself"
        for _ in range(MEASURE_TRIES):
            self._link.request_motors("check", unchecked=True)
            self._move(Velocity(V_M_S, 0.0))
            base = self._link.about_base(measure=True)
            if base is not None and base.state is TimeoutState.RUNNING:
                break
        if base is None or base.state is not TimeoutState.RUNNING:
            return False, f"the timeout was not measured: {base.reason if base else 'no answer'}"
        ended_s = self._clock.monotonic() + MEASURING_S
        while base is not None and base.state is TimeoutState.RUNNING and self._clock.monotonic() < ended_s:
            self._until(lambda: False, POLL_S)
            self._link.request_motors("check", unchecked=True)  # without the lease, the bridge sends zeros
            base = self._link.about_base()
        if base is not None and base.state is TimeoutState.MEASURED:
            measured_s = math.ceil(100.0 * (base.timeout_s or 0.0)) / 100.0
            line = f"measured_base_timeout_s: {measured_s:g} # {date.today()}"
            return True, f"if the bridge dies, the base halts; the line for the robot's description: {line}"
        if base is not None and base.state is TimeoutState.UNKNOWN:
            return False, "the timeout was not measured: a stop or a loss of the base ended the measurement"
        return False, "if the bridge dies, the base does not halt: the bridge needs --no-base-watchdog"

    def _gate_since(self, before: GateStatus) -> str:
        """Return a text on what the gate did to commands since ``before``, with its reasons."""
        gate = self._link.gate
        words = []
        if reason := gate.held or gate.ended:
            detail = f" ({gate.ended_detail})" if gate.ended_detail else ""
            words.append(f"the gate stopped the robot: {reason}{detail}")
        for what, old, new in (
            ("stopped the robot for a moment", before.stops, gate.stops),
            ("dropped commands", before.dropped, gate.dropped),
            ("limited commands", before.limited, gate.limited),
        ):
            grown = [name for name, count in new.items() if count > old.get(name, 0) and name != reason]
            if grown:
                words.append(f"the gate {what}: {', '.join(grown)}")
        return "; ".join(words) or "the gate passed all commands on, look at the base's motors and encoders"

    def _move(self, velocity: Velocity) -> tuple[OdometrySample, OdometrySample, float]:
        """Command a velocity for a while; return first and last report, and the distance by its speed."""
        try:
            return self._command(velocity)
        except SafetyStop as stop:
            if stop.rule != NOT_ACCEPTED:
                raise
        # A second attempt, for the reason of `ATTEMPTS`, after the gate's status has arrived.
        self._link.request_motors("check", unchecked=True)
        self._until(lambda: False, ACCEPTED_S)
        return self._command(velocity)

    def _command(
        self, velocity: Velocity, seconds: float = MOVE_S
    ) -> tuple[OdometrySample, OdometrySample, float]:
        before = newest = self._newest
        by_speed, due = 0.0, self._clock.monotonic()
        end = due + seconds
        while self._clock.monotonic() < end:
            self._link.command(velocity)
            self._link.lease.check(self._link.gate, self._clock.monotonic_ns())
            due += PERIOD_S
            self._until(lambda: False, max(0.0, due - self._clock.monotonic()))
            last, newest = newest, self._newest
            by_speed += newest.sample.velocity.v * (newest.ref.measured_ns - last.ref.measured_ns) * 1e-9
        return before.sample, newest.sample, by_speed

    @property
    def _speed_mean_s(self) -> float:
        return 0.0 if self._robot is None else self._robot.odometry.speed_mean_s

    @property
    def _newest(self) -> Measurement[OdometrySample]:
        assert self._measurements.newest is not None  # the first check received some
        return self._measurements.newest

    def _stands(self) -> bool:
        v, omega = self._newest.sample.velocity
        return abs(v) < STANDING and abs(omega) < STANDING

    def _until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Take odometry until a condition holds; return False if it did not in time."""

        def holds() -> bool:
            self._measurements.odometry(0)
            return condition()

        return self._monitor.until(holds, timeout_s)
