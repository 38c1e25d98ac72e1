"""From a base's packets to its state in SI units: counters that wrap, flags, bumpers, sonars.

Position counters have 15 bits (ARCOS, ARIA) or 16 (AMRISim), headings 12: only their modular differences
count. A pose is that of the base since it was connected or reset; its heading is not wrapped.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from bridge.pioneer.packets import ConfigPac, Flag, Sip
from bridge.pioneer.robots import RobotParameters

COUNTER_BITS, HEADING_BITS = 15, 12

_RESET_NEAR_M, _RESET_NEAR_RAD = 0.1, 0.2
"""A requested reset has happened when the counters are this near to zero."""


@dataclass(frozen=True)
class BaseState:
    """The state in one SIP. SI units; x, y, theta in the frame where the base was at connect or reset."""

    received_s: float
    """The ``now`` of the SIP's last byte."""
    x: float
    y: float
    theta: float
    """Heading in rad, counter-clockwise, not wrapped."""
    v: float
    omega: float
    moving: bool
    motors_enabled: bool
    stop_pressed: bool
    stalled: tuple[bool, bool]
    """Left and right motor."""
    bumpers: tuple[int, int]
    """Bits of the front and rear segments, bit 0 first; always 0 when the base is not known to have any."""
    battery_v: float
    sonar: Mapping[int, float] = field(default_factory=dict)
    """Ranges in m of the sonars read since the last SIP, by number."""
    flags: int = 0
    faults: int = 0
    """FLAGS and FAULTFLAGS as they came."""
    digin: int = 0
    charge_state: int | None = None


def counter_difference(new: int, old: int, bits: int) -> int:
    """Return how far a wrapping counter went, the shorter way round.

    >>> counter_difference(3, 0x7FFE, 15)
    5
    """
    half = 1 << (bits - 1)
    return (new - old + half) % (2 * half) - half


class Odometer:
    """Accumulates one base's SIPs. Made anew for each connection."""

    def __init__(self, robot: RobotParameters) -> None:
        self.robot = robot
        self.config: ConfigPac | None = None
        self._last: Sip | None = None
        # Where the base is and where it was at connect or reset, both in the base's own odometry frame.
        self._x = self._y = self._theta = 0.0
        self._x0 = self._y0 = self._theta0 = 0.0
        self._reset_asked = False

    @property
    def reset_pending(self) -> bool:
        """Whether a reset was requested and no SIP has shown it yet."""
        return self._reset_asked

    def expect_reset(self) -> None:
        """SETO was sent: the counters will jump to zero with one of the next SIPs."""
        self._reset_asked = True

    def update(self, sip: Sip, now: float) -> BaseState:
        """Return the state in a SIP."""
        self._accumulate(sip)
        cos, sin = math.cos(self._theta0), math.sin(self._theta0)
        dx, dy = self._x - self._x0, self._y - self._y0
        speed = self.robot.velocity_m_s
        if sip.rotvel is None:
            omega = (sip.right - sip.left) / 2 * speed / self.robot.half_track_m
        else:
            omega = math.radians(sip.rotvel / 10)
        return BaseState(
            received_s=now,
            x=cos * dx + sin * dy,
            y=cos * dy - sin * dx,
            theta=self._theta - self._theta0,
            v=(sip.left + sip.right) / 2 * speed,
            omega=omega,
            moving=sip.moving,
            motors_enabled=bool(sip.flags & Flag.MOTORS),
            stop_pressed=bool(sip.flags & (Flag.STOP_BUTTON | Flag.E_STALL)),
            stalled=(bool(sip.stall_left & 1), bool(sip.stall_right & 1)),
            bumpers=self._bumpers(sip),
            battery_v=(sip.battery_x10 or sip.battery_dv) / 10,
            sonar={number: range_mm / 1000 for number, range_mm in sip.sonar},
            flags=sip.flags,
            faults=sip.faults or 0,
            digin=sip.digin or 0,
            charge_state=sip.charge_state,
        )

    def _accumulate(self, sip: Sip) -> None:
        distance, angle = self.robot.distance_m, self.robot.theta_rad
        x = counter_difference(sip.x, 0, COUNTER_BITS) * distance
        y = counter_difference(sip.y, 0, COUNTER_BITS) * distance
        theta = counter_difference(sip.theta, 0, HEADING_BITS) * angle
        near_zero = math.hypot(x, y) < _RESET_NEAR_M and abs(theta) < _RESET_NEAR_RAD
        if self._reset_asked and near_zero:
            # If these are still the old counters, near zero by chance, the jump that follows is as small and
            # counts as motion: the pose is right again after it.
            self._x, self._y, self._theta = x, y, theta
            self._x0 = self._y0 = self._theta0 = 0.0
            self._reset_asked = False
        elif self._last is None:
            self._x, self._y, self._theta = x, y, theta
            self._x0, self._y0, self._theta0 = x, y, theta
        else:
            self._x += counter_difference(sip.x, self._last.x, COUNTER_BITS) * distance
            self._y += counter_difference(sip.y, self._last.y, COUNTER_BITS) * distance
            self._theta += counter_difference(sip.theta, self._last.theta, HEADING_BITS) * angle
        self._last = sip

    def _bumpers(self, sip: Sip) -> tuple[int, int]:
        """Return the bits of the bumpers in the CONFIGpac; a base without them may report all as pressed."""
        if self.config is None:
            return 0, 0
        front, rear = self.config.front_bumps, self.config.rear_bumps
        return sip.stall_right >> 1 & ((1 << front) - 1), sip.stall_left >> 1 & ((1 << rear) - 1)
