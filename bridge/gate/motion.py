"""Motion that the gate allows: inside the fence, away from obstacles and contact, within the accelerations.

Contact is a pressed bumper or a stall. A lease granted in it allows driving away, nothing else:

1. Contact that a lease was not granted in is a hazard, and revokes it.
2. A lease is granted in contact that leaves one direction free: front or rear, never both. A stall is on the
   side to which the rover was moving; without such a side it counts as both.
3. Contact counts until the base reports its end and the driver then sends zero or a command that leads away.
   So a rover that is freed does not start forward by itself.
"""

import math
from collections.abc import Iterator

from bridge.base import BaseReport
from bridge.gate.limits import Limits
from bridge.gate.state import NO_CONTACT, Contact, GateState
from rover_ncp.core.geometry import Velocity, wrap_angle
from rover_ncp.wire.protocol import Fence

REACT_S = 0.3
"""Longest time from command to first braking; the fence assumes it besides braking."""
ROLLING = 0.05
"""From this reported speed in m/s on, the fence also assumes that the base brakes from its reported speed."""
FASTEST = Velocity(1.2, 3.0)
"""Reported speeds beyond the largest `Limits` count as these."""
ARC_RAD = 0.1
"""Largest turn between two points of an arc."""
CIRCLE = 63
"""With so many steps an arc is a full circle; more of them lead to no new place."""
JUMP_M, JUMP_RAD = 0.05, 0.1
"""Poses may differ by this beyond the reported motion: noise, turns about another point than the centre."""
LATE_S = 0.3
"""A report may have waited for so much longer than the next one, and reports between them may be lost."""

AWAY_M_S = 0.1
"""Speed limit for driving away from contact. Without turning: that would drag the corners along."""
STALL_CLEARS_S = 1.0
"""A stall must end within this time after a lease was granted in it."""
STANDING = 0.01
"""Below this, in m/s and rad/s, a reported speed counts as standing."""


def leaves(fence: Fence, base: BaseReport, target: Velocity, age_s: float, brake: float) -> bool:
    """Whether a base that is to move at ``target`` would stop outside the fence, no nearer to it than now.

    Its report is ``age_s`` old. While the base stops, its turn rate may lie anywhere between zero, its
    reported rate and the commanded one.
    """
    rolling = clamp(base.v, FASTEST.v)
    speeds = (target.v, rolling if abs(rolling) >= ROLLING and any(target) else 0.0)
    turns = (0.0, target.omega, clamp(base.omega, FASTEST.omega))
    slow, fast = min(turns), max(turns)
    now = fence.outside(base.x, base.y)
    return any(
        outside > 0.0 and outside >= now
        for v in speeds
        for omega in (slow, (slow + fast) / 2.0, fast)
        for outside in _outside(fence, base, Velocity(v, omega), age_s + REACT_S + abs(v) / (2.0 * brake))
        if v != 0.0
    )


def _outside(fence: Fence, base: BaseReport, velocity: Velocity, time_s: float) -> Iterator[float]:
    """Yield how far the points of an arc are outside the fence, for ``time_s`` at ``velocity``."""
    x, y = base.x, base.y
    steps = math.ceil(abs(velocity.omega) * time_s / ARC_RAD) or 1
    step_s = time_s / steps
    for k in range(min(steps, CIRCLE)):
        heading = base.theta + velocity.omega * step_s * (k + 0.5)
        x += velocity.v * step_s * math.cos(heading)
        y += velocity.v * step_s * math.sin(heading)
        yield fence.outside(x, y)


def jumps(before: BaseReport, base: BaseReport, elapsed_s: float, limits: Limits) -> bool:
    """Whether a pose is farther from the one before than the rover can have moved.

    It moved at most at the faster of the two reported speeds, or as fast as a command lets a rover get that
    stood at both times. A finite pose after one that was not finite also jumps.
    """
    reached = Velocity(
        min(limits.accel * elapsed_s, limits.v_max), min(limits.alpha * elapsed_s, limits.omega_max)
    )
    v = max(reached.v, *(abs(clamp(report.v, FASTEST.v)) for report in (before, base)))
    omega = max(reached.omega, *(abs(clamp(report.omega, FASTEST.omega)) for report in (before, base)))
    moved_m, turned_rad = math.hypot(base.x - before.x, base.y - before.y), base.theta - before.theta
    time_s = elapsed_s + LATE_S
    return all(map(math.isfinite, (base.x, base.y, base.theta))) and not (
        moved_m <= JUMP_M + v * time_s
        and math.isfinite(turned_rad)
        and abs(wrap_angle(turned_rad)) <= JUMP_RAD + omega * time_s
    )


def clear(base: BaseReport, v: float, min_m: float) -> bool:
    """Whether the clearance in the direction of ``v`` is known and at least ``min_m``."""
    ahead = v <= 0.0 or base.clear_ahead_m >= min_m
    behind = v >= 0.0 or base.clear_behind_m >= min_m
    return ahead and behind


def approach(target: Velocity, before: Velocity, limits: Limits, elapsed: float) -> Velocity:
    """Return the target within the allowed acceleration."""
    return Velocity(
        _toward(before.v, target.v, limits.accel * elapsed),
        _toward(before.omega, target.omega, limits.alpha * elapsed),
    )


def clamp(value: float, bound: float) -> float:
    """Return a value within ±``bound``."""
    return min(max(value, -bound), bound)


def _toward(before: float, wanted: float, growth: float) -> float:
    """Let a magnitude grow by ``growth`` at most, from zero where the sign changes."""
    start = abs(before) if before * wanted > 0.0 else 0.0
    return math.copysign(min(abs(wanted), start + growth), wanted)


# Contact


def known_contact(state: GateState) -> Contact:
    """Return the contact that is no hazard under the present lease."""
    lease = state.lease
    if lease is None:
        return NO_CONTACT
    recent = state.now - lease.granted_s <= STALL_CLEARS_S
    return lease.contact._replace(stalled=lease.contact.stalled and recent)


def one_sided_contact(state: GateState) -> Contact:
    """Return the contact that is no hazard to a new lease."""
    contact = _reported(state.base)
    return NO_CONTACT if all(_sides(contact, state.stalled_v)) else contact


def lasting_contact(state: GateState, known: Contact, command: Velocity) -> Contact:
    """Return what remains of ``known`` contact after a command."""
    if not leads_away(state, known, command):
        return known
    now = _reported(state.base)
    return Contact(known.front & now.front, known.rear & now.rear, known.stalled and now.stalled)


def leads_away(state: GateState, known: Contact, command: Velocity) -> bool:
    """Whether a command leads away from all contact, or asks for no motion."""
    ahead, behind = _sides(known, state.stalled_v)
    return not any(command) or ((command.v < 0.0 or not ahead) and (command.v > 0.0 or not behind))


def bounded(known: Contact, command: Velocity, limits: Limits) -> Velocity:
    """Return a command within the speed limits."""
    if any(known):
        return Velocity(clamp(command.v, min(AWAY_M_S, limits.v_max)), 0.0)
    return Velocity(clamp(command.v, limits.v_max), clamp(command.omega, limits.omega_max))


def stall_direction(state: GateState, base: BaseReport) -> float:
    """Return 1 if the rover moved forward when a motor began to stall, −1 if backward, 0 if unknown.

    It is known if the setpoint and the reported speed agree, or one of them is zero.
    """
    before = state.base
    if not any(base.stalled) or (before is not None and any(before.stalled)):
        return state.stalled_v
    speeds = state.out.v, 0.0 if before is None else before.v
    signs = {math.copysign(1.0, speed) for speed in speeds if abs(speed) >= STANDING}
    return signs.pop() if len(signs) == 1 else 0.0


def _reported(base: BaseReport | None) -> Contact:
    return NO_CONTACT if base is None else Contact(*base.bumpers, any(base.stalled))


def _sides(contact: Contact, stalled_v: float) -> tuple[bool, bool]:
    """Whether contact is ahead and behind."""
    ahead = contact.front != 0 or (contact.stalled and stalled_v >= 0.0)
    behind = contact.rear != 0 or (contact.stalled and stalled_v <= 0.0)
    return ahead, behind
