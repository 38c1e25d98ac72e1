"""Contact, which is a pressed bumper or a stall: a lease granted in it allows driving away, nothing else.

1. Contact that a lease was not granted in is a hazard, and revokes it.
2. A lease is granted in contact that leaves one direction free: front or rear, never both. A stall is on the
   side to which the rover was moving; without such a side it counts as both.
3. Contact counts until the base reports its end and the driver then sends zero or a command that leads away.
   So a rover that is freed does not start forward by itself.
"""

import math

from bridge.base import BaseReport
from bridge.gate.limits import Limits
from bridge.gate.motion import clamp
from bridge.gate.state import NO_CONTACT, Contact, GateState
from rover_ncp.core.geometry import Velocity

AWAY_M_S = 0.1
"""Speed limit for driving away from contact. Without turning: that would drag the corners along."""
STALL_CLEARS_S = 1.0
"""A stall must end within this time after a lease was granted in it."""
STANDING = 0.01
"""Below this, in m/s and rad/s, a reported speed counts as standing."""


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
