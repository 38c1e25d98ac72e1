"""Requests to a ready base: speeds, motors, limits, keep-alives.

The base acknowledges nothing, and links lose packets. So setpoints are repeated while they are in force, and
the request for the motors is repeated until the SIPs show its effect. Motors that were on and went off by
themselves (stop button, stall) are not switched on again: the driver must request that. Speeds other than
zero are sent only while the SIPs say that the motors are on.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from bridge.base import BaseReport
from bridge.pioneer.framing import Command
from rover_ncp.core.geometry import STANDSTILL, Velocity

PULSE_S, REFRESH_S = 0.5, 0.2
"""Period of PULSE while the motors are off (the watchdog waits 2 s), of the setpoints while they are on."""
VERIFY_S, ENABLE_TRIES = 0.3, 3
"""A request that the SIPs do not show after this time is repeated; the motors' ENABLE 1 so many times."""
STANDING = 0.002
"""Dead band in m/s and rad/s: commands within both ask for a standing rover. It is the allowed mean error."""
HOLD_S, MAX_HOLD_S = 0.05, 0.25
"""Least duration of a turn setpoint, unless the command changes, and the longest that is accounted for."""
_EARLY_S = 0.002
"""Tolerance for a loop at 20 Hz that runs a little early; without it half of its ticks would be lost."""


@dataclass(frozen=True)
class MotionLimits:
    """Limits set in the base: m/s, rad/s, m/s², rad/s². Accelerations: the paper's simulator."""

    v: float = 0.3
    omega: float = 0.6
    accel: float = 0.31
    decel: float = 0.31
    alpha: float = 1.25
    alpha_decel: float = 1.25


class Quantiser:
    """Speeds in SI to the whole mm/s and deg/s that a base takes, right on average.

    A degree a second is a tenth of the parking turn rate, too coarse to round. So each turn setpoint is one
    of the two whole degrees next to the command, and the remainder is carried over: the mean over a second is
    within 0.002 rad/s of the command. A zero command sends zero and carries nothing over.
    """

    def __init__(self) -> None:
        self._command = STANDSTILL
        self._chosen = (0, 0)
        self._chosen_s = self._stepped_s = -math.inf
        self._owed = 0.0
        """Angle that was commanded but not sent, in rad."""

    def zero(self) -> None:
        """Command zero and drop the remainder."""
        self._command, self._chosen, self._owed = STANDSTILL, (0, 0), 0.0

    def step(self, command: Velocity, now: float) -> tuple[int, int]:
        """Return VEL (mm/s) and RVEL (deg/s) that stand for a finite command from ``now`` on."""
        # The last step's setpoint has been in force since then, for the command of the last step.
        missed = self._command.omega - math.radians(self._chosen[1])
        self._owed += missed * min(now - self._stepped_s, MAX_HOLD_S)
        changed = command != self._command
        self._command, self._stepped_s = command, now
        if abs(command.v) < STANDING and abs(command.omega) < STANDING:
            self.zero()
        elif changed or now - self._chosen_s >= HOLD_S - _EARLY_S:
            hold = min(max(now - self._chosen_s, HOLD_S), MAX_HOLD_S)
            deg_s = math.degrees(command.omega)
            wanted = round(math.degrees(command.omega + self._owed / hold))
            self._chosen = round(command.v * 1000), min(max(wanted, math.floor(deg_s)), math.ceil(deg_s))
            self._chosen_s = now
        return self._chosen


class Setpoints:
    """The requests to one base. Its session calls what sends only while the base is ready."""

    def __init__(self, limits: MotionLimits, send: Callable[[Command, int | None], None]) -> None:
        self._limits = limits
        self._send = send
        self._quantiser = Quantiser()
        self._velocity = STANDSTILL
        self._sent = (0, 0)
        self._sent_s = self._motors_s = -math.inf
        self._wanted = False
        self._enable_tries = 0

    def take(self, now: float) -> None:
        """Take over a base that just became ready: limits, sonars, zero setpoints, motors off."""
        self._wanted = False
        self._send_limits()
        self._send(Command.SONAR, 1)
        self.zero(now)
        self._send_enable(now)

    def set_motion(self, velocity: Velocity) -> None:
        """Set the speeds that the next tick sends."""
        self._velocity = velocity if self._wanted else STANDSTILL

    def enable(self, on: bool, now: float) -> None:
        """Ask for the motors or switch them off, standing still."""
        self._wanted = on
        self._enable_tries = 0
        if on:
            self._send_limits()
        self.zero(now)
        self._send_enable(now)

    def emergency_stop(self, now: float) -> None:
        """Stop now, beyond the deceleration limit."""
        self._send(Command.E_STOP, None)
        self.zero(now)

    def zero(self, now: float) -> None:
        """Send zero setpoints and clear the command in force."""
        self._clear_motion()
        self._send_speeds(0, 0, now)

    def tick(self, report: BaseReport | None, now: float) -> None:
        """Send what is due. ``report`` is the newest."""
        if report is not None and now - self._motors_s >= VERIFY_S:
            if report.motors_on and self._wanted:
                self._enable_tries = ENABLE_TRIES
            elif report.motors_on or (self._wanted and self._enable_tries < ENABLE_TRIES):
                self.zero(now)
                self._send_enable(now)
        if report is None or not report.motors_on:
            self._clear_motion()
        speeds = self._quantiser.step(self._velocity, now)
        if speeds != self._sent or (self._wanted and now - self._sent_s >= REFRESH_S):
            self._send_speeds(*speeds, now)
        elif now - self._sent_s >= PULSE_S:
            self._send(Command.PULSE, None)
            self._sent_s = now

    def _clear_motion(self) -> None:
        self._velocity = STANDSTILL
        self._quantiser.zero()

    def _send_speeds(self, v_mm_s: int, omega_deg_s: int, now: float) -> None:
        self._send(Command.VEL, v_mm_s)
        self._send(Command.RVEL, omega_deg_s)
        self._sent, self._sent_s = (v_mm_s, omega_deg_s), now

    def _send_enable(self, now: float) -> None:
        self._send(Command.ENABLE, int(self._wanted))
        self._motors_s = now
        self._enable_tries += 1

    def _send_limits(self) -> None:
        limits = self._limits
        # Rounded up, so that the base does not change a setpoint within the limits.
        self._send(Command.SETV, math.ceil(limits.v * 1000 - 1e-6))
        self._send(Command.SETA, round(limits.accel * 1000))
        self._send(Command.SETA, -round(limits.decel * 1000))
        self._send(Command.SETRV, math.ceil(math.degrees(limits.omega) - 1e-6))
        self._send(Command.SETRA, round(math.degrees(limits.alpha)))
        self._send(Command.SETRA, -round(math.degrees(limits.alpha_decel)))
