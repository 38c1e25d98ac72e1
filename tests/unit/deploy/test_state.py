import pytest

from deploy.drive.phases import FINAL, TRANSITIONS, Event, Impossible, State, next_state

W, A, D, P, E, F = State.WAITING, State.ARMED, State.DRIVING, State.PARKED, State.ENDED, State.FAULT
X = None

# Written out a second time, by row (state) and column (event), so that a slip in the table shows.
#            READY GRANTED PARKED NOT_PARKED INTERRUPTED FAULT
EXPECTED = {
    W: (A, X, X, X, E, F),
    A: (X, D, X, X, E, F),
    D: (X, X, P, E, E, F),
    P: (X, X, X, X, P, P),
    E: (X, X, X, X, E, E),
    F: (X, X, X, X, F, F),
}
PAIRS = [
    (state, event, follower)
    for state, row in EXPECTED.items()
    for event, follower in zip(Event, row, strict=True)
]


@pytest.mark.parametrize(("state", "event", "follower"), PAIRS)
def test_every_pair(state, event, follower):
    if follower is None:
        with pytest.raises(Impossible, match=f"{event.value} while {state.value}"):
            next_state(state, event)
    else:
        assert next_state(state, event) is follower


def test_the_table_is_whole():
    assert set(TRANSITIONS) == set(State)
    assert all(set(row) == set(Event) for row in TRANSITIONS.values())


def test_a_final_state_keeps():
    assert {state for state in State if set(TRANSITIONS[state].values()) <= {state, None}} == FINAL


def test_driving_is_reached_only_through_armed_by_the_grant():
    ways = [(s, e) for s, row in TRANSITIONS.items() for e, to in row.items() if to is State.DRIVING]
    assert ways == [(State.ARMED, Event.GRANTED)]
