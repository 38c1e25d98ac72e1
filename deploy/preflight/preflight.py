"""Pre-flight check of a robot on blocks: sensors, direction of motion, stop without commands.

Each check is a function that returns whether it passed, and its finding. The first that fails ends the list:
later ones would fail for the same cause. The wheels move at walking pace for a few seconds.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from deploy.drive.link import Link
from deploy.drive.measurements import Intake, Sample
from rover_ncp.core.cdr import decode
from rover_ncp.core.errors import FormatError, NoBridge, RoverNcpError, SafetyStop
from rover_ncp.core.geometry import Velocity, wrap_angle
from rover_ncp.core.key_table import spec
from rover_ncp.core.protocol import GateStatus
from rover_ncp.core.recording import Recorded

V_M_S, OMEGA_RAD_S = 0.1, 0.2
"""Slow, and still well above the noise of wheels in the air."""
MOVE_S, PERIOD_S = 1.5, 0.05
RATE_HZ, LISTEN_S = 8.0, 2.0
"""A base reports ten times a second; fewer than eight, and packets are lost."""
BATTERY_V = 11.5
"""The base's own alarm level (Pioneer manual); below it a drive may end in the middle."""
STOP_S = 0.5
"""The first safety requirement; braking and the time to the next report come on top."""
BRAKING_S, REPORT_S = 0.15 + V_M_S / 0.3, 0.1
SCALE = 0.15
"""How far the way by the pose and the way by the speed may differ, as a share."""
STANDING = 0.01


@dataclass(frozen=True)
class Finding:
    """Result of one check."""

    name: str
    ok: bool
    detail: str


class Preflight:
    """Checks one robot. At every end, the lease is released."""

    def __init__(self) -> None:
        self._battery_v = math.nan
        self._intake: Intake | None = None

    def record(self, message: Recorded) -> None:
        """Receive the link's messages, as its recorder."""
        if message.topic == "battery_state":
            try:
                self._battery_v = decode(spec("battery_state").type, message.data).voltage
            except FormatError:
                self._battery_v = math.nan

    def run(self, link: Link) -> list[Finding]:
        """Run all checks, in this order. Raises NoBridge when there is none."""
        self._link = link
        if not self._until(lambda: link.bridge_alive, 5.0):
            raise NoBridge(f"something answers at {link.robot}, but no bridge shows itself there within 5 s")
        self._intake = Intake(link.odometry)
        findings: list[Finding] = []
        looks = {
            "odometry": self._reports,
            "battery": self._battery,
            "stop": self._free,
            "motors": self._motors,
            "forward": self._forward,
            "left": self._left,
            "silence": self._stop,
        }
        try:
            for name, look in looks.items():
                gate = link.gate
                try:
                    ok, detail = look()
                except SafetyStop as stop:  # the gate accepts no more commands
                    ok, detail = False, f"{stop}: {self._gate_since(gate)}"
                findings.append(Finding(name, ok, detail))
                if not ok:
                    break
        finally:
            link.release()
        return findings

    def _reports(self) -> tuple[bool, str]:
        self._wait(LISTEN_S)
        rate = self._heard.count / LISTEN_S
        return rate >= RATE_HZ, f"{rate:.1f} reports a second (at least {RATE_HZ:g})"

    def _battery(self) -> tuple[bool, str]:
        self._until(lambda: math.isfinite(self._battery_v), 2.0)
        volts = self._battery_v
        return volts >= BATTERY_V, f"{volts:.1f} V (at least {BATTERY_V} V)"

    def _free(self) -> tuple[bool, str]:
        gate = self._link.gate
        holder = gate.driver_name or ("a driver without a name" if gate.lease else gate.held)
        return not holder, f"held by {holder}" if holder else "nothing holds the rover"

    def _motors(self) -> tuple[bool, str]:
        try:
            began = time.monotonic()
            self._link.request_motors("check")
        except RoverNcpError as error:
            return False, str(error)
        return True, f"granted within {time.monotonic() - began:.3f} s"

    def _forward(self) -> tuple[bool, str]:
        gate = self._link.gate
        before, after, way = self._move(Velocity(V_M_S, 0.0))
        ahead = (after.pose.x - before.pose.x) * math.cos(before.pose.theta) + (
            after.pose.y - before.pose.y
        ) * math.sin(before.pose.theta)
        if after.velocity.v <= 0.5 * V_M_S or ahead <= 0.0:
            moved = f"commanded {V_M_S} m/s, the base reports {after.velocity.v:.2f} m/s and {ahead:.2f} m"
            return False, f"{moved}: {self._gate_since(gate)}"
        right = abs(ahead - way) <= SCALE * way
        return right, f"{ahead:.3f} m by its pose, {way:.3f} m by its speed"

    def _left(self) -> tuple[bool, str]:
        gate = self._link.gate
        before, after, _ = self._move(Velocity(0.0, OMEGA_RAD_S))
        turned = wrap_angle(after.pose.theta - before.pose.theta)
        right = after.velocity.omega > 0.5 * OMEGA_RAD_S and turned > 0.0
        reported = f"{after.velocity.omega:.2f} rad/s and {turned:.2f} rad"
        moved = f"commanded {OMEGA_RAD_S} rad/s, the base reports {reported}"
        return right, moved if right else f"{moved}: {self._gate_since(gate)}"

    def _stop(self) -> tuple[bool, str]:
        """Test the most important stop: no commands arrive any more."""
        self._move(Velocity(V_M_S, 0.0))
        silent = time.monotonic()
        allowed = STOP_S + BRAKING_S + REPORT_S
        stands = self._until(self._standing, 2 * allowed)
        took = time.monotonic() - silent
        ok = stands and took <= allowed
        words = f"stands {took:.2f} s after the last command" if stands else "does not stop"
        return ok, f"{words} (at most {allowed:.2f} s)"

    def _gate_since(self, before: GateStatus) -> str:
        """Return a text on what the gate did to commands since ``before``, with its reasons."""
        gate = self._link.gate
        words = []
        if reason := gate.held or gate.ended:
            words.append(f"the gate stopped the robot: {reason}")
        for verb, old, new in (
            ("dropped", before.dropped, gate.dropped),
            ("limited", before.limited, gate.limited),
        ):
            grown = [name for name, count in new.items() if count > old.get(name, 0)]
            if grown:
                words.append(f"the gate {verb} commands: {', '.join(grown)}")
        return "; ".join(words) or "the gate passed all commands on, look at the base's motors and encoders"

    def _move(self, velocity: Velocity) -> tuple[Sample, Sample, float]:
        """Command a velocity for a while; return first and last report, and the way by the reported speed."""
        before = newest = self._newest()
        way, due = 0.0, time.monotonic()
        end = due + MOVE_S
        while time.monotonic() < end:
            self._link.command(velocity)
            self._link.lease.check(self._link.gate, time.monotonic_ns())
            due += PERIOD_S
            last, newest = newest, self._newest(max(0.0, due - time.monotonic()))
            way += newest.velocity.v * (newest.ref.measured_ns - last.ref.measured_ns) * 1e-9
        return before, newest, way

    def _newest(self, wait_s: float = 0.0) -> Sample:
        self._wait(wait_s)
        newest = self._heard.newest
        assert newest is not None  # the first look saw some
        return newest

    @property
    def _heard(self) -> Intake:
        assert self._intake is not None  # the looks begin with the bridge there
        return self._intake

    def _standing(self) -> bool:
        v, omega = self._newest().velocity
        return abs(v) < STANDING and abs(omega) < STANDING

    def _wait(self, seconds: float) -> None:
        self._until(lambda: False, seconds)

    def _until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        deadline = time.monotonic() + timeout_s
        while True:
            left = deadline - time.monotonic()
            pause = min(max(left, 0.0), 0.01)
            if self._intake is None:
                time.sleep(pause)
            else:
                self._intake.take(pause)
            if condition():
                return True
            if left <= 0.0:
                return False
