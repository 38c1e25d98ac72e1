"""The inverse of the motors' dead zone: slow commands become pulses of whole control ticks, right on average.

A base stands at a command below its dead band, or turns a slow wheel at another speed than commanded. So a
driver that knows the dead band sends such a command as 0 or as the least speed that moves the base. The
difference is carried over to the next tick (error diffusion). `pulsed`, `is_slow` and `clear_of` are also
compiled into the training's kernel.
"""

import math
from typing import NamedTuple

from rover_ncp.core.geometry import Velocity
from rover_ncp.course.course import TICK_S, Course
from rover_ncp.robot.description import DeadBand, RobotDescription
from rover_ncp.robot.profile import RoverProfile

MARGIN = 0.1
"""Share by which a pulse exceeds the dead band: a base may count it after its gain."""
STEP = Velocity(0.001, math.radians(1.0))
"""A Pioneer takes whole mm/s and deg/s, and may get the next smaller one."""
PULSE_TICKS = 3
"""Shortest pulse: gate and base take one to two ticks to accelerate to a large dead band."""

COMING_TO_REST_S = 1.0
"""Time to come to rest before the verdict's standstill; until then, small commands correct the pose."""
HOLD = Velocity(0.004, math.radians(1.0))
"""Near the end of a course, commands below both follow only noise of the estimate: a parked rover holds."""
HOLD_WITHIN = 0.75
"""Share of the tolerances within which a rover that could only be corrected by pulses holds near the end: a
pulse would be motion while it has to stand still. Twice that share of 2 degrees is more than the turn of a pulse
at a dead band of 0.1 rad/s."""


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


def is_slow(v: float, omega: float, band_v: float, band_omega: float) -> bool:
    """Return whether a base with these bands follows a command by pulses alone, or it answers noise."""
    return abs(v) < max(HOLD.v, band_v) and abs(omega) < max(HOLD.omega, band_omega)


def clear_of(band: float, step: float) -> float:
    """Return the least speed to send for a dead band; 0 for none."""
    return (1.0 + MARGIN) * band + step if band > 0.0 else 0.0


def hold_of(course: Course) -> tuple[float, float, float]:
    """Return when a driver begins to hold near the goal, in ticks, and within what m and rad."""
    rule = course.parked
    since_s = course.horizon_s - rule.still_s - COMING_TO_REST_S
    return since_s / TICK_S, HOLD_WITHIN * rule.position_m, HOLD_WITHIN * rule.heading_rad
