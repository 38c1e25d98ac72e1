"""The inverse of the motors' dead zone: slow commands become pulses of whole control ticks, right on average.

A base stands at a command below its dead band, or turns a slow wheel at another speed than commanded. So a
driver that knows the dead band sends such a command as 0 or as the least speed that moves the base. The
difference is carried over to the next tick (error diffusion). ``episode.cpp`` of the native library repeats
`pulsed`.
"""

import math
from typing import NamedTuple

from rover_ncp.core.geometry import Velocity
from rover_ncp.robot.description import DeadBand, RobotDescription
from rover_ncp.robot.profile import RoverProfile

MARGIN = 0.1
"""Share by which a pulse exceeds the dead band: a base may count it after its gain."""
STEP = Velocity(0.001, math.radians(1.0))
"""A Pioneer takes whole mm/s and deg/s, and may get the next smaller one."""
PULSE_TICKS = 3
"""Shortest pulse: gate and base take one to two ticks to accelerate to a large dead band."""


class Pulse(NamedTuple):
    """The command of one speed in a tick."""

    sent: float = 0.0
    owed: float = 0.0
    """Sum of the wanted commands that were not sent."""
    ticks: int = 0
    """Ticks that the pulse has lasted, up to `PULSE_TICKS`; 0 between pulses."""


def pulsed(wanted: float, least: float, before: Pulse) -> Pulse:
    """Return the command for a wanted speed: that speed, or 0 or ``least`` if it is too slow for the motors.

    >>> pulsed(0.03, 0.05, Pulse())
    Pulse(sent=0.05, owed=-0.020000000000000004, ticks=1)
    """
    if wanted == 0.0 or abs(wanted) >= least:
        return Pulse(wanted, 0.0, 0)
    total = wanted + before.owed
    if 0 < before.ticks < PULSE_TICKS:
        sent = before.sent
    else:
        due = total * math.copysign(1.0, wanted) >= 0.5 * least
        sent = math.copysign(least, wanted) if due else 0.0
    return Pulse(sent, total - sent, before.ticks % PULSE_TICKS + 1 if sent else 0)


class DeadZone:
    """Commands of one drive for a base with a dead band; without one they pass unchanged."""

    def __init__(self, rover: RoverProfile | None = None, described: RobotDescription | None = None) -> None:
        band = described.motion.dead_band if described else DeadBand()
        v, omega = band.v, band.omega
        if rover is not None:
            v = v if rover.dead_band_v is None else rover.dead_band_v
            omega = omega if rover.dead_band_omega is None else rover.dead_band_omega
        wheel = described.motion.wheel_min if described else 0.0
        self._half_track = described.half_track_m if described else 1.0
        self._least = clear_of(v, STEP.v), clear_of(omega, STEP.omega)
        self._wheel_least = clear_of(wheel, 0.0)
        self.band = Velocity(max(v, wheel), max(omega, wheel / self._half_track))
        """Least speed and least turn rate that the base follows, each by itself; 0: it follows all."""
        self.least = Velocity(
            max(self._least[0], self._wheel_least), max(self._least[1], self._wheel_least / self._half_track)
        )
        """Speed and turn rate below which a command becomes pulses; 0: never."""
        self._pulses = [Pulse()] * 4
        """Of v, omega, the left and the right wheel."""

    def pass_on(self, command: Velocity) -> Velocity:
        """Return the command to send in this tick."""
        v = self._pulsed(0, command.v, self._least[0])
        omega = self._pulsed(1, command.omega, self._least[1])
        if not self._wheel_least:
            return Velocity(v, omega)
        half = self._half_track
        left = self._pulsed(2, v - omega * half, self._wheel_least)
        right = self._pulsed(3, v + omega * half, self._wheel_least)
        return Velocity(0.5 * (left + right), 0.5 * (right - left) / half)

    def _pulsed(self, place: int, wanted: float, least: float) -> float:
        pulse = self._pulses[place] = pulsed(wanted, least, self._pulses[place])
        return pulse.sent


def clear_of(band: float, step: float) -> float:
    """Return the least speed to send for a dead band; 0 for none."""
    return (1.0 + MARGIN) * band + step if band > 0.0 else 0.0
