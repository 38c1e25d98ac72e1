"""Requests to a ready base: speeds, motors, limits, odometry reset, keep-alives.

The base acknowledges nothing, and links lose packets. So setpoints are repeated while they are in force, and
requests whose effect the SIPs show (motors, reset counters) are repeated until they show it. Motors that were
on and went off by themselves (stop button, stall) are not switched on again: the driver must request that.
Speeds other than zero are sent only while the SIPs say that the motors are on.
"""

import math
from typing import Protocol

from bridge.pioneer.arcos import Command
from bridge.pioneer.odometry import BaseState
from bridge.pioneer.quantise import MotionLimits, SetPoints

PULSE_S, REFRESH_S = 0.5, 0.2
"""Period of PULSE while the motors are off (the watchdog waits 2 s), of the setpoints while they are on."""

VERIFY_S, ENABLE_TRIES = 0.3, 3
"""A request that the SIPs do not show after this time is repeated; the motors' ENABLE 1 so many times."""


class Send(Protocol):
    """Sends one command with its argument."""

    def __call__(self, command: Command, argument: int | None = None) -> None:
        """Send a command."""


class Helm:
    """The commands to one base. Its session calls what sends only while the base is ready."""

    def __init__(self, limits: MotionLimits, send: Send) -> None:
        self._limits = limits
        self._send = send
        self._set_points = SetPoints(limits)
        self._sent = (0, 0)
        self._sent_s = self._motors_s = self._reset_s = -math.inf
        self._wanted = False
        self._enable_tries = 0

    def take(self, now: float) -> None:
        """Take over a base that just became ready: limits, sonars, zero setpoints, motors off."""
        self._wanted = False
        self._send_limits()
        self._send(Command.SONAR, 1)
        self.zero(now)
        self._send_enable(now)

    def set_motion(self, v: float, omega: float) -> None:
        """Set the speeds the next tick sends. Raises ValueError when one is not finite."""
        self._set_points.command(v, omega)
        if not self._wanted:
            self._set_points.zero()

    def enable(self, on: bool, motors_on: bool, now: float) -> None:
        """Ask for the motors or switch them off, standing still. They stay on if they are already."""
        if on and self._wanted and motors_on:
            return
        self._wanted = on
        self._enable_tries = 0
        if on:
            self._send_limits()
        self.zero(now)
        self._send_enable(now)

    def halt(self, how: Command, now: float) -> None:
        """Stop now, with STOP or E_STOP."""
        self._send(how)
        self.zero(now)

    def zero(self, now: float) -> None:
        """Send zero setpoints and clear the command in force."""
        self._set_points.zero()
        self._send_speeds(0, 0, now)

    def let_go(self) -> None:
        """Clear the command in force and the request for the motors; sends nothing."""
        self._wanted = False
        self._set_points.zero()

    def reset_odometry(self, now: float) -> None:
        """Request a reset of the counters."""
        self._send(Command.SETO)
        self._reset_s = now

    def tick(self, state: BaseState | None, reset_pending: bool, now: float) -> None:
        """Send what is due. ``state`` is the base's latest; a reset is pending until its counters show it."""
        if state is not None and now - self._motors_s >= VERIFY_S:
            if state.motors_enabled and self._wanted:
                self._enable_tries = ENABLE_TRIES
            elif state.motors_enabled or (self._wanted and self._enable_tries < ENABLE_TRIES):
                self.zero(now)
                self._send_enable(now)
        if reset_pending and now - self._reset_s >= VERIFY_S:
            self.reset_odometry(now)
        if state is None or not state.motors_enabled:
            self._set_points.zero()
        speeds = self._set_points.step(now)
        if speeds != self._sent or (self._wanted and now - self._sent_s >= REFRESH_S):
            self._send_speeds(*speeds, now)
        elif now - self._sent_s >= PULSE_S:
            self._send(Command.PULSE)
            self._sent_s = now

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
        self._send(Command.SETV, limits.v_mm_s)
        self._send(Command.SETA, round(limits.accel * 1000))
        self._send(Command.SETA, -round(limits.decel * 1000))
        self._send(Command.SETRV, limits.omega_deg_s)
        self._send(Command.SETRA, round(math.degrees(limits.alpha)))
        self._send(Command.SETRA, -round(math.degrees(limits.alpha_decel)))
