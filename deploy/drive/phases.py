"""The states of a drive, and what may follow what.

Rules of this file:

1. Everything that changes the state stands in `TRANSITIONS`, a row for every state and event.
2. Only in DRIVING may a command other than zero leave this process.
3. A fault wins over everything that is still going on.
4. PARKED, ENDED and FAULT are final: another drive is another process.
5. Whatever cannot happen raises `Impossible`: it is a mistake in this program, not in the world.
"""

from enum import Enum


class State(Enum):
    """Where a drive stands."""

    WAITING = "waiting"
    """For the bridge, for the right to command, and for odometry of a rover that stands still."""
    ARMED = "armed"
    """The start pose is known; the motors are being asked for."""
    DRIVING = "driving"
    """The circuit drives, or in a dry run would."""
    PARKED = "parked"
    """The time is over and the rover stands where it should."""
    ENDED = "ended"
    """Over without being parked: somewhere else, too early, or interrupted."""
    FAULT = "fault"
    """A safety rule stopped the rover."""


class Event(Enum):
    """What moves a drive on."""

    READY = "ready"
    """Bridge, permission and steady odometry are there."""
    GRANTED = "granted"
    """The motors are ours; in a dry run nobody is asked."""
    PARKED = "judged parked"
    """The time is over; the estimate says parked."""
    NOT_PARKED = "judged not parked"
    """The time is over; the estimate says otherwise."""
    INTERRUPTED = "interrupted"
    """Somebody asked for an end: Ctrl-C, SIGTERM."""
    FAULT = "fault"
    """A safety rule was broken, or a part of this program failed."""


class Impossible(RuntimeError):
    """An event came in a state in which it cannot happen."""


_IMPOSSIBLE = None

TRANSITIONS: dict[State, dict[Event, State | None]] = {
    State.WAITING: {
        Event.READY: State.ARMED,
        Event.GRANTED: _IMPOSSIBLE,
        Event.PARKED: _IMPOSSIBLE,
        Event.NOT_PARKED: _IMPOSSIBLE,
        Event.INTERRUPTED: State.ENDED,
        Event.FAULT: State.FAULT,
    },
    State.ARMED: {
        Event.READY: _IMPOSSIBLE,
        Event.GRANTED: State.DRIVING,
        Event.PARKED: _IMPOSSIBLE,
        Event.NOT_PARKED: _IMPOSSIBLE,
        Event.INTERRUPTED: State.ENDED,
        Event.FAULT: State.FAULT,
    },
    State.DRIVING: {
        Event.READY: _IMPOSSIBLE,
        Event.GRANTED: _IMPOSSIBLE,
        Event.PARKED: State.PARKED,
        Event.NOT_PARKED: State.ENDED,
        Event.INTERRUPTED: State.ENDED,
        Event.FAULT: State.FAULT,
    },
    # A final state keeps: what comes while the motors are released and files closed changes no verdict.
    **{
        final: {
            Event.READY: _IMPOSSIBLE,
            Event.GRANTED: _IMPOSSIBLE,
            Event.PARKED: _IMPOSSIBLE,
            Event.NOT_PARKED: _IMPOSSIBLE,
            Event.INTERRUPTED: final,
            Event.FAULT: final,
        }
        for final in (State.PARKED, State.ENDED, State.FAULT)
    },
}

FINAL = frozenset({State.PARKED, State.ENDED, State.FAULT})


def next_state(state: State, event: Event) -> State:
    """Return the state that follows. Raises Impossible."""
    follower = TRANSITIONS[state][event]
    if follower is None:
        raise Impossible(f"{event.value} while {state.value}")
    return follower
