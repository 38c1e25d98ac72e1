"""The states of a drive and the transitions between them.

Rules of this file:

1. Everything that changes the state stands in `TRANSITIONS`, a row for every state and event.
2. Only in DRIVING may a command other than zero leave this process.
3. A fault overrides every state that is not final.
4. PARKED, ENDED and FAULT are final: another drive is another process.
5. An event that cannot happen in a state raises `Impossible`: it is an error in this program.
"""

from enum import Enum


class State(Enum):
    """State of a drive."""

    WAITING = "waiting"
    """Waiting for the bridge, for the right to command, and for odometry of a rover that stands still."""
    ARMED = "armed"
    """The start pose is known; the driver requests the motors."""
    DRIVING = "driving"
    """The circuit drives, or in a dry run would."""
    PARKED = "parked"
    """The time is over and the rover is parked."""
    ENDED = "ended"
    """The drive ended and the rover is not parked: another place, too early, or interrupted."""
    FAULT = "fault"
    """A safety rule stopped the rover."""


class Event(Enum):
    """Events that change the state of a drive."""

    READY = "ready"
    """Bridge, permission and steady odometry are there."""
    GRANTED = "granted"
    """The driver holds the lease; in a dry run it makes no request."""
    PARKED = "judged parked"
    """The time is over; the estimate says parked."""
    NOT_PARKED = "judged not parked"
    """The time is over; the estimate says otherwise."""
    INTERRUPTED = "interrupted"
    """A termination signal was received: Ctrl-C, SIGTERM."""
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
    # A final state stays: events while the lease is released and files are closed change no verdict.
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
