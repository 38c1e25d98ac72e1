"""The safety gate: the one function between all commands and the setpoint of the base.

Rules of this file:

1. `step` is the only entry: state and event in, state and verdict out. No I/O and no clock; ``now`` is the
   bridge's monotonic clock in seconds.
2. The verdict's velocity is always finite and within the limits. It is sent, published and recorded.
3. The output is zero unless all of these hold: the base reports in time, no stop is latched, no hazard is
   flagged, the motors are on, there is a lease, and its holder sent a command that is fresh, new and finite.
4. A hazard revokes the lease: the driver must request it again. In contact, a new lease allows driving away
   only (`motion.py`). Stale commands or odometry only hold the rover. So do fence and sonars: the rover may
   be driven away from them.
5. The gate limits the speeds and how fast they grow. It never delays braking.
6. Commands, renewals and releases without the lease's signature are dropped. First requests and stops act
   without one. The caller verifies digests and makes keys: `step` draws no random numbers.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

from bridge.base import BaseReport
from bridge.gate.limits import Limits
from bridge.gate.motion import (
    STANDING,
    approach,
    bounded,
    clear,
    jumps,
    known_contact,
    lasting_contact,
    leads_away,
    leaves,
    one_sided_contact,
    stall_direction,
)
from bridge.gate.state import (
    NO_CONTACT,
    BaseLost,
    Contact,
    Enable,
    GateEvent,
    GateState,
    Lease,
    Reason,
    Release,
    ReleaseStop,
    Stop,
    VelocityCommand,
    Verdict,
    describe,
)
from rover_ncp.core.clock_offset import update_clock_offset
from rover_ncp.core.geometry import STANDSTILL, Velocity

MOTORS_GRACE_S = 1.0
"""How long after ENABLE the base may still report its motors off."""
COAST_S = 2.0
"""Without a lease, motors are switched off when the rover stands, or after this."""
FROZEN_M, FROZEN_RAD = 0.01, 0.02
"""Odometry is frozen if the base moved this far by its own speeds and reports the same pose."""
FOLLOWS_S = 0.25
"""A base that moves so long after a halt was commanded last does not halt."""
FROZEN_REPORTS = 2
"""At least this many repeated reports: noisy odometry repeats the same millimetre once by chance."""
STEP_MAX_S = 0.1
"""A loop that was delayed gains no acceleration for the time of the delay."""


def step(state: GateState, event: GateEvent, now: float, limits: Limits) -> tuple[GateState, Verdict]:
    """Process one event at ``now`` and return the new state and the verdict for the base."""
    elapsed = min(max(now - state.now, 0.0), STEP_MAX_S)
    state = _expire(state._replace(now=max(now, state.now)))
    refusal = dropped = None
    match event:
        case BaseReport():
            state = _take_report(state, event, limits)
        case BaseLost(reason):
            restarted = state.odometry_restarted or event.restarted
            lost = reason or state.lost
            state = state._replace(base=None, lost=lost, low_since_s=None, odometry_restarted=restarted)
        case Enable():
            state, refusal = _enable(state, event, limits)
        case Release(sequence) if state.lease is not None and sequence > state.lease.last_sequence:
            state = _end_lease(state, None)
        case Stop(reason):
            state = state._replace(stop_reason=reason)
        case ReleaseStop():
            state = state._replace(stop_reason=None)
        case VelocityCommand():
            state, dropped = _command(state, event, limits)
        case _:  # time alone, or a release that was repeated or came after the lease ended
            pass
    hazard = _hazard(state, limits, known_contact(state))
    if hazard is not None and state.lease is not None:
        state = _end_lease(state, hazard)
    held = hazard or _hold_reason(state, limits)
    if state.held is None and held not in {None, Reason.NO_LEASE}:
        state = state._replace(stops=_count(state.stops, held))
    velocity = STANDSTILL
    if held is None and state.target is not None:
        velocity = approach(state.target, state.out, limits, elapsed)
    halted_s = state.now if velocity == STANDSTILL and not _stands(state.base) else state.halted_s
    state = _switch_motors(state._replace(held=held, out=velocity, halted_s=halted_s))
    return state, Verdict(velocity, state.motors, held, refusal, dropped, state.lease)


def _hazard(state: GateState, limits: Limits, known: Contact) -> Reason | None:
    """Return the active hazard, if any; ``known`` contact is no hazard."""
    base, low, lease = state.base, state.low_since_s, state.lease
    if state.stop_reason is not None:
        return Reason.STOPPED
    if base is None:
        return Reason.NO_BASE
    for flagged, reason in (
        (base.stop_pressed, Reason.STOP_BUTTON),
        (base.hazard_unknown, Reason.HAZARD_UNKNOWN),
        (base.bumpers[0] & ~known.front or base.bumpers[1] & ~known.rear, Reason.BUMPER),
        (any(base.stalled) and not known.stalled, Reason.STALL),
        (low is not None and state.now - low >= limits.battery_low_s, Reason.LOW_BATTERY),
        (_frozen(state), Reason.FROZEN),
        (state.odometry_restarted and limits.fence is not None, Reason.FENCE_LOST),
    ):
        if flagged:
            return reason
    if lease is not None and not base.motors_on and state.now - lease.granted_s > MOTORS_GRACE_S:
        return Reason.MOTORS_OFF
    return None


def _hold_reason(state: GateState, limits: Limits) -> Reason | None:
    """Return the hold reason, if any."""
    base, target = state.base, state.target
    reason = None
    if base is None or _odometry_stale(state, base, limits):
        reason = Reason.ODOMETRY
    elif state.lease is None:
        reason = Reason.NO_LEASE
    elif not base.motors_on:
        reason = Reason.MOTORS_OFF
    elif target is None:
        reason = state.no_command
    elif state.now > state.target_until_s:
        reason = Reason.SILENCE
    elif limits.fence is not None and leaves(
        limits.fence, base, target, state.now - state.base_s + base.age_s, limits.brake
    ):
        reason = Reason.GEOFENCE
    elif limits.sonar_stop_m is not None and not clear(base, target.v, limits.sonar_stop_m):
        reason = Reason.SONAR
    return reason


def _frozen(state: GateState) -> bool:
    """Whether odometry is frozen: the base reports the same pose while it reports a speed."""
    moved = abs(state.frozen_m) >= FROZEN_M or abs(state.frozen_rad) >= FROZEN_RAD
    return moved and state.repeats >= FROZEN_REPORTS


def _odometry_stale(state: GateState, base: BaseReport, limits: Limits) -> bool:
    """Whether odometry is stale or not finite."""
    numbers = (base.x, base.y, base.theta, base.v, base.omega)
    return state.now - state.base_s > limits.odometry_s or not all(map(math.isfinite, numbers))


def _take_report(state: GateState, base: BaseReport, limits: Limits) -> GateState:
    """Store a base report; update the start of low battery and the distance driven at the same pose.

    A pose that jumps shows that odometry restarted.
    """
    before, low_since_s, repeats, frozen_m, frozen_rad = state.base, None, 0, 0.0, 0.0
    elapsed, pose_s, restarted = state.now - state.base_s, state.now, state.odometry_restarted
    if before is not None:
        restarted = restarted or jumps(before, base, elapsed, limits)
    if before is not None and (base.x, base.y, base.theta) == (before.x, before.y, before.theta):
        repeats, pose_s = state.repeats + 1, state.pose_s
        frozen_m, frozen_rad = state.frozen_m, state.frozen_rad
        # A mean speed goes on after a rover that was told to halt stands.
        driven = pose_s - state.halted_s > FOLLOWS_S
        if driven or state.now - min(pose_s, state.halted_s) > limits.speed_mean_s:
            frozen_m += _sustained_speed(before.v, base.v) * elapsed
            frozen_rad += _sustained_speed(before.omega, base.omega) * elapsed
    if not base.battery_v > 0.0:  # not known: a voltage that was low is taken to be low still
        low_since_s = state.low_since_s
    elif base.battery_v < limits.battery_min_v:
        low_since_s = state.now if state.low_since_s is None else state.low_since_s
    return state._replace(
        stalled_v=stall_direction(state, base),
        base=base,
        base_s=state.now,
        odometry_restarted=restarted,
        low_since_s=low_since_s,
        pose_s=pose_s,
        repeats=repeats,
        frozen_m=frozen_m,
        frozen_rad=frozen_rad,
    )


def _sustained_speed(before: float, now: float) -> float:
    """Return the slower of two speeds; 0 unless they have one direction and exceed the noise at rest."""
    slower = min(before, now, key=abs)
    return slower if before * now > 0.0 and abs(slower) >= STANDING else 0.0


def _enable(state: GateState, request: Enable, limits: Limits) -> tuple[GateState, Reason | None]:
    """Grant or renew the lease, or return the refusal. A new lease resets the driver's clock offset.

    A renewal does not: on a link that became slow it would make stale commands look fresh.
    """
    base, lease = state.base, state.lease
    sequence = -1 if lease is None else request.sequence
    if sequence is None:
        return state, Reason.ANOTHER_DRIVER
    if lease is not None and sequence <= lease.last_sequence:
        return state, Reason.REPEATED
    contact = one_sided_contact(state) if lease is None else known_contact(state)
    hazard = _hazard(state, limits, contact)
    if hazard is not None or base is None:
        return state, hazard
    if _odometry_stale(state, base, limits):
        return state, Reason.ODOMETRY
    granted = Lease(
        number=state.leases + 1 if lease is None else lease.number,
        secret=request.secret if lease is None else lease.secret,
        name=request.name,
        granted_s=state.now if lease is None else lease.granted_s,
        expires_s=state.now + limits.lease_s,
        last_sequence=sequence,
        contact=contact,
    )
    return state._replace(
        lease=granted,
        leases=granted.number,
        lease_over=None,
        lease_over_detail="",
        target=None,
        no_command=Reason.SILENCE,
        minima=update_clock_offset(() if lease is None else state.minima, state.now, request.sent_ns),
        motors=True,
    ), None


def _expire(state: GateState) -> GateState:
    """End a lease whose holder has sent nothing for too long."""
    if state.lease is not None and state.now > state.lease.expires_s:
        return _end_lease(state, Reason.LEASE_LAPSED)
    return state


def _end_lease(state: GateState, reason: Reason | None) -> GateState:
    return state._replace(
        lease=None,
        lease_over=reason,
        lease_over_detail="" if reason is None else describe(reason, state),
        target=None,
        motors_until_s=state.now + COAST_S,
    )


def _switch_motors(state: GateState) -> GateState:
    """Without a lease, switch the motors off at standstill, or `COAST_S` after the lease's end."""
    if state.lease is not None or not state.motors:
        return state
    return state._replace(motors=not _stands(state.base) and state.now < state.motors_until_s)


def _stands(base: BaseReport | None) -> bool:
    """Whether a base reports no motion, or nothing."""
    return base is None or (abs(base.v) < STANDING and abs(base.omega) < STANDING)


class _Admitted(NamedTuple):
    """A command with valid sender and time; its content is not yet checked."""

    state: GateState
    lease: Lease
    sent_s: float
    """Estimated time of sending, on our clock."""


def _command(state: GateState, command: VelocityCommand, limits: Limits) -> tuple[GateState, Reason | None]:
    """Put a command in force, or return the reason for dropping it."""
    velocity, admitted = command.velocity, _admit(state, command, limits)
    if isinstance(admitted, Reason):
        return state._replace(dropped=_count(state.dropped, admitted)), admitted
    state, flaw = admitted.state, _flaw(velocity)
    if flaw is not None:
        # The driver that holds the lease is faulty: the command before this one is not carried out further.
        return state._replace(target=None, no_command=flaw, dropped=_count(state.dropped, flaw)), flaw
    assert velocity is not None  # else it has a flaw
    contact, limited = lasting_contact(state, admitted.lease.contact, velocity), state.limited
    allowed = bounded(contact, velocity, limits)
    if velocity.v != allowed.v:
        limited = _count(limited, Reason.SPEED)
    if velocity.omega != allowed.omega:
        limited = _count(limited, Reason.TURN)
    return state._replace(
        lease=replace(admitted.lease, expires_s=state.now + limits.lease_s, contact=contact),
        target=allowed if leads_away(state, contact, velocity) else None,
        no_command=Reason.BUMPER if contact.front or contact.rear else Reason.STALL,
        target_until_s=admitted.sent_s + limits.command_timeout_s,
        accepted=state.accepted + 1,
        limited=limited,
    ), None


def _admit(state: GateState, command: VelocityCommand, limits: Limits) -> _Admitted | Reason:
    """Check signature, sequence number and age.

    The offset between the two clocks is unknown. The smallest (arrival − stamp) of the last minute is the
    best estimate of it; the excess over it is this command's age.
    """
    lease, tag = state.lease, command.tag
    if lease is None:
        return _hazard(state, limits, NO_CONTACT) or Reason.NO_LEASE
    if not command.signed:
        return Reason.FOREIGN
    if tag.sequence <= lease.last_sequence:
        return Reason.REPEATED
    minima = update_clock_offset(state.minima, state.now, tag.stamp_ns)
    age = state.now - tag.stamp_ns * 1e-9 - min(offset for _, offset in minima)
    if age > limits.stale_s:
        return Reason.STALE
    lease = replace(lease, last_sequence=tag.sequence)
    return _Admitted(state._replace(lease=lease, minima=minima), lease, state.now - age)


def _flaw(velocity: Velocity | None) -> Reason | None:
    """Return why a command is not a finite velocity, if it is none."""
    if velocity is None:
        return Reason.UNREADABLE
    return None if all(map(math.isfinite, velocity)) else Reason.NOT_FINITE


def _count(counts: Mapping[Reason, int], reason: Reason) -> Mapping[Reason, int]:
    return {**counts, reason: counts.get(reason, 0) + 1}
