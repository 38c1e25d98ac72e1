"""From a base's packets to its reports in SI units: counters that wrap, flags, bumpers, sonars.

Position counters have 15 bits (ARCOS, ARIA) or 16 (AMRISim), headings 12: only their modular differences
count. A pose is that of the base since it was connected; its heading is not wrapped.

A report's clearance is the shortest recent range of the sonars ahead and behind. The base fires one sonar of
each array at a time, so a SIP holds two or three ranges; a round of an array takes about a third of a second.
"""

import math
from collections.abc import Iterable

from bridge.base import BaseReport
from bridge.pioneer.packets import ConfigPac, Flag, Sip
from rover_ncp.core.geometry import ORIGIN, Pose
from rover_ncp.robot.description import RobotDescription, load_description

ROBOTS = {name: load_description(name) for name in ("p3at", "p3at-sh", "p3dx", "p3dx-sh")}
"""The Pioneers by the subtype that the base reports in SYNC2 (``-sh``: the SH2 controller with ARCOS)."""
COUNTER_BITS, HEADING_BITS = 15, 12
HEADING_RAD = math.tau / 4096
"""Radians per unit of THPOS, for every client."""
WHEEL_SPEED_M_S = 0.001
"""Metres per second per unit of wheel speed."""
_RANGE_VALID_S = 1.0
"""A sonar range expires after this time: three rounds."""
_AHEAD_RAD = math.radians(45.0)
"""Only sonars within this angle of straight ahead or straight back count for the clearance."""
_CHARGING = {0: False, 1: True, 2: True, 3: True}
"""CHARGESTATE: not charging, bulk, overcharge, float; anything else is not known."""


def counter_difference(new: int, old: int, bits: int) -> int:
    """Return how far a wrapping counter went, the shorter way round.

    >>> counter_difference(3, 0x7FFE, 15)
    5
    """
    half = 1 << (bits - 1)
    return (new - old + half) % (2 * half) - half


class Odometer:
    """Accumulates the SIPs of one base, which has ``arcos``. Made anew for each connection."""

    def __init__(self, robot: RobotDescription) -> None:
        assert robot.arcos is not None
        self.robot = robot
        self._distance_m, self._half_track_m = robot.arcos.distance_mm / 1000, robot.half_track_m
        self.config: ConfigPac | None = None
        self._last: Sip | None = None
        # Where the base is and where it was at connect, both in the base's own odometry frame.
        self._pose = self._origin = ORIGIN
        headings = [abs(sonar.theta) for sonar in robot.sonar_poses]
        self._ahead = [k for k, heading in enumerate(headings) if heading <= _AHEAD_RAD]
        self._behind = [k for k, heading in enumerate(headings) if heading >= math.pi - _AHEAD_RAD]
        self._ranges: dict[int, tuple[float, float]] = {}
        """Last range in m of each sonar, and when it came."""

    def update(self, sip: Sip, now: float) -> BaseReport:
        """Return the report of a SIP that came at ``now``."""
        self._accumulate(sip)
        sonar = {number: range_mm / 1000 for number, range_mm in sip.sonar}
        self._ranges |= {number: (range_m, now) for number, range_m in sonar.items()}
        pose, origin = self._pose, self._origin
        cos, sin = math.cos(origin.theta), math.sin(origin.theta)
        dx, dy = pose.x - origin.x, pose.y - origin.y
        if sip.rotvel is None:
            omega = (sip.right - sip.left) / 2 * WHEEL_SPEED_M_S / self._half_track_m
        else:
            omega = math.radians(sip.rotvel / 10)
        return BaseReport(
            x=cos * dx + sin * dy,
            y=cos * dy - sin * dx,
            theta=pose.theta - origin.theta,
            v=(sip.left + sip.right) / 2 * WHEEL_SPEED_M_S,
            omega=omega,
            battery_v=(sip.battery_x10 or sip.battery_dv) / 10,
            charging=None if sip.charge_state is None else _CHARGING.get(sip.charge_state),
            motors_on=bool(sip.flags & Flag.MOTORS),
            stop_pressed=bool(sip.flags & (Flag.STOP_BUTTON | Flag.E_STALL)),
            stalled=(bool(sip.stall_left & 1), bool(sip.stall_right & 1)),
            bumpers=self._bumpers(sip),
            sonar=sonar,
            clear_ahead_m=self._shortest(self._ahead, now),
            clear_behind_m=self._shortest(self._behind, now),
            flags=sip.flags,
            faults=sip.faults or 0,
        )

    def _accumulate(self, sip: Sip) -> None:
        distance = self._distance_m
        x = counter_difference(sip.x, 0, COUNTER_BITS) * distance
        y = counter_difference(sip.y, 0, COUNTER_BITS) * distance
        theta = counter_difference(sip.theta, 0, HEADING_BITS) * HEADING_RAD
        if self._last is None:
            self._pose = self._origin = Pose(x, y, theta)
        else:
            last, pose = self._last, self._pose
            self._pose = Pose(
                pose.x + counter_difference(sip.x, last.x, COUNTER_BITS) * distance,
                pose.y + counter_difference(sip.y, last.y, COUNTER_BITS) * distance,
                pose.theta + counter_difference(sip.theta, last.theta, HEADING_BITS) * HEADING_RAD,
            )
        self._last = sip

    def _bumpers(self, sip: Sip) -> tuple[int, int]:
        """Return the bits of the bumpers in the CONFIGpac; a base without them may report all as pressed."""
        if self.config is None:
            return 0, 0
        front, rear = self.config.front_bumps, self.config.rear_bumps
        return sip.stall_right >> 1 & ((1 << front) - 1), sip.stall_left >> 1 & ((1 << rear) - 1)

    def _shortest(self, sonars: Iterable[int], now: float) -> float:
        """Return the shortest range of some sonars; NaN if one of them sent nothing for too long."""
        known = [self._ranges.get(number, (0.0, -math.inf)) for number in sonars]
        if any(now - received_s > _RANGE_VALID_S for _, received_s in known):
            return math.nan
        return min((range_m for range_m, _ in known), default=math.nan)
