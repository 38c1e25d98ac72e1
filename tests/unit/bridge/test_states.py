"""Every (state, input) pair of a session, written down independently of the table it comes from."""

import pytest
from kit.arcos_bench import Bench

from bridge.base import BaseReport, Failed, Lost, Ready, Recovered
from bridge.pioneer.framing import Command
from bridge.pioneer.session import BaudChanged, Session
from bridge.pioneer.states import PATIENCE_S, TABLE, Input, SessionState

OUTSIDE = [
    *(Input.CONNECT, Input.CLOSE, Input.LINK_DOWN, Input.EXPIRED, Input.ECHO0, Input.ECHO1),
    *(Input.NAMES, Input.STRANGER, Input.SIP, Input.CONFIG, Input.RESET),
]
LETTERS = dict(zip("IL012HCRXAF", SessionState, strict=True))
# A row for each state, a letter for each input of OUTSIDE: the next state, or = for nothing at all.
#            connect close down expired echo0 echo1 names stranger sip config reset
NEXT = {
    "I": "L    =     =    =       =     =     =     =        =   =      =",
    "L": "=    I     I    0       1     2     C     I        H   =      L",
    "0": "=    I     I    L       1     L     L     L        H   =      L",
    "1": "=    I     I    L       =     2     L     L        H   =      L",
    "2": "=    I     I    L       L     =     C     I        H   =      L",
    "H": "=    I     I    0       =     =     =     =        =   =      L",
    "C": "=    I     I    C       =     =     =     =        C   C      L",
    "R": "=    I     I    X       L     =     =     =        R   R      L",
    "X": "=    I     I    I       L     =     =     =        R   =      L",
    "A": "=    I     I    F       =     =     =     =        =   =      L",
    "F": "=    I     I    R       =     =     =     =        R   =      L",
}
ZEROS = [Command.VEL, Command.RVEL, Command.STOP]
LIMITS = [*[Command.SETV, Command.SETA, Command.SETA], *[Command.SETRV, Command.SETRA, Command.SETRA]]
TAKE = [*LIMITS, Command.SONAR, Command.VEL, Command.RVEL, Command.ENABLE]
LEAVE = [*ZEROS, Command.ENABLE, Command.CLOSE]
SENT = {
    **{(letter, Input.CLOSE): [Command.CLOSE] for letter in "012H"},
    **{(letter, Input.CLOSE): LEAVE for letter in "CRXAF"},
    **{(letter, Input.SIP): [*ZEROS, Command.CLOSE] for letter in "L012"},
    ("L", Input.EXPIRED): [Command.PULSE],
    ("H", Input.EXPIRED): [Command.PULSE],
    **{(letter, Input.ECHO0): [Command.OPEN] for letter in "L0"},
    **{(letter, Input.ECHO1): [Command.CLOSE] for letter in "L1"},
    **{(letter, Input.NAMES): [Command.OPEN, Command.CONFIG] for letter in "L2"},
    **{(letter, Input.STRANGER): [Command.CLOSE] for letter in "L2"},
    ("C", Input.EXPIRED): [Command.OPEN, Command.CONFIG],
    ("R", Input.EXPIRED): ZEROS,
    ("X", Input.SIP): TAKE,
    ("A", Input.EXPIRED): [Command.PULSE],
    ("F", Input.SIP): TAKE,
    ("F", Input.EXPIRED): TAKE,
}
EVENTS: dict[tuple[str, Input], list[type]] = {
    **{(letter, Input.STRANGER): [Failed] for letter in "L2"},
    ("R", Input.SIP): [BaseReport],
    ("R", Input.EXPIRED): [Lost],
    ("R", Input.ECHO0): [Lost],
    ("R", Input.RESET): [Lost],
    ("R", Input.LINK_DOWN): [Lost],
    ("X", Input.EXPIRED): [Failed],
    ("X", Input.SIP): [Recovered, BaseReport],
    ("A", Input.EXPIRED): [BaudChanged],
    ("F", Input.SIP): [Ready],
    ("F", Input.EXPIRED): [BaudChanged, Ready],
}
PAIRS = [
    (letter, what, outcome)
    for letter, row in NEXT.items()
    for what, outcome in zip(OUTSIDE, row.split(), strict=True)
]


@pytest.mark.parametrize(
    ("letter", "what", "outcome"), PAIRS, ids=lambda v: v.name if isinstance(v, Input) else v
)
def test_every_state_with_every_input(letter, what, outcome):
    bench = Bench().go_to(LETTERS[letter])
    bench.apply(what)
    after = LETTERS[letter] if outcome == "=" else LETTERS[outcome]
    assert bench.session.state is after
    assert bench.commands() == SENT.get((letter, what), [])
    assert [type(event) for event in bench.events] == EVENTS.get((letter, what), [])


def test_every_action_of_the_table_exists_and_every_pair_was_tried():
    actions = {action for row in TABLE.values() for _, action in row.values()}
    assert all(isinstance(each, Command) or hasattr(Session, f"_do_{each}") for each in actions - {None})
    assert set(TABLE) == set(SessionState) == set(PATIENCE_S)
    inner = {what for row in TABLE.values() for what in row} - set(OUTSIDE)
    assert inner == {Input.GAVE_UP, Input.SETTLED, Input.SLOW}
