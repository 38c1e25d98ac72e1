"""The true motion of a mock's rover: its speed, and the time until it stands."""

import time
from bisect import bisect_left

from sim.park.live import TimedOut
from sim.park.truth import TrueState, TruthReader
from sim.world.rover import STILL_M_S, STILL_RAD_S

SAMPLE_S = 0.01
"""Time between two lines of the mock's file; also the mock's step."""


def moving(state: TrueState) -> bool:
    """Return whether the rover moves."""
    return abs(state.velocity.v) > STILL_M_S or abs(state.velocity.omega) > STILL_RAD_S


def states_since(truth: TruthReader, clock_ns: int) -> list[TrueState]:
    """Return the states from a moment of the simulation clock on."""
    states = truth.read()
    return states[bisect_left(states, clock_ns, key=lambda state: state.clock_ns) :]


def speed(truth: TruthReader) -> float:
    """Return the newest v in m/s, 0 before the first state."""
    states = truth.read()
    return states[-1].velocity.v if states else 0.0


def stood_after(truth: TruthReader, since_ns: int, timeout_s: float = 6.0, still_s: float = 0.3) -> float:
    """Wait until the rover has stood for ``still_s``; return the time in s from ``since_ns`` to its stop.

    ``since_ns`` is of the simulation clock. The rover stands from the first state on in which it does not
    move: at most `SAMPLE_S` too late. Returns 0 if it never moved. Raises TimedOut.
    """
    deadline = time.monotonic() + timeout_s
    while True:
        states = states_since(truth, since_ns)
        last_ns = next((state.clock_ns for state in reversed(states) if moving(state)), None)
        if states and states[-1].clock_ns - (last_ns or since_ns) > still_s * 1e9:
            return 0.0 if last_ns is None else (last_ns - since_ns) * 1e-9 + SAMPLE_S
        if time.monotonic() > deadline:
            raise TimedOut(f"the rover still moves {timeout_s:g} s after it should have stopped")
        time.sleep(0.02)
