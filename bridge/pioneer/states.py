"""The states of a connection to a base and every change between them, as data.

1. A (state, input) pair that is not in ``TABLE`` does nothing.
2. The state changes first, then the action runs.
3. Entering a state, its own included, starts that state's clock (``PATIENCE_S``); an entry without a state
   leaves state and clock alone. EXPIRED is the clock's end.

Sources: Adept Pioneer 3 manual p. 33 (handshake); what a base may answer instead, from ARIA's
ArRobot::asyncConnectHandler and AMRISim's handleSyncPacket (facts only).
"""

import math
from enum import Enum
from typing import TypeAlias


class State(Enum):
    """The state of a connection to a base."""

    IDLE = "not connected"
    LISTENING = "listening for an old session"
    SYNC0 = "SYNC0 sent"
    SYNC1 = "SYNC1 sent"
    SYNC2 = "SYNC2 sent"
    HANGING_UP = "closing an old session"
    CONFIGURING = "open, waiting for SIP and CONFIGpac"
    READY = "ready"
    LOST = "the base went silent"
    ASKING_FASTER = "asked for a faster line"
    FASTER = "at the faster rate, not heard yet"


class Input(Enum):
    """Inputs of the state machine."""

    CONNECT = "connect was called"
    CLOSE = "close was called"
    LINK_DOWN = "the line under us is gone"
    EXPIRED = "the state's clock ran out"
    GAVE_UP = "tried often or long enough"
    ECHO0 = "echo of SYNC0"
    ECHO1 = "echo of SYNC1"
    NAMES = "echo of SYNC2 from a base we know"
    STRANGER = "echo of SYNC2 from a base we have no factors for"
    SIP = "server information packet"
    CONFIG = "CONFIGpac"
    SETTLED = "SIPs come, and the CONFIGpac came or never will"
    SLOW = "the same, on a slow line that could be faster"
    RESET = "notice that the base was reset"


LOSS_S = 0.5
"""Without a SIP for this long a base counts as lost (design, safety requirement 1)."""

PATIENCE_S = {
    State.IDLE: math.inf,
    State.LISTENING: 0.25,  # an open session speaks each 0.1 s
    State.SYNC0: 0.7,  # AMRISim takes up to 0.5 s
    State.SYNC1: 0.7,
    State.SYNC2: 0.7,
    State.HANGING_UP: 0.4,  # as long as Player's p2os waits after CLOSE
    State.CONFIGURING: 0.2,  # ARIA's rhythm of asking for the CONFIGpac
    State.READY: LOSS_S,
    State.LOST: 1.8,  # with LOSS_S more than the base's watchdog, 2 s: a base cut off has halted before SYNC0
    State.ASKING_FASTER: 0.05,  # ARIA waits 10 ms; HOSTBAUD's 9 bytes take that long at 9600 alone
    State.FASTER: 0.9,  # as long as ARIA waits for a packet
}
"""How long a state lasts by itself, in seconds."""

Entry: TypeAlias = tuple[State | None, str]

_ENDING: dict[Input, Entry] = {
    Input.CLOSE: (State.IDLE, "say_close"),
    Input.LINK_DOWN: (State.IDLE, "nothing"),
}
_SYNCING: dict[Input, Entry] = _ENDING | {
    Input.SIP: (State.HANGING_UP, "hang_up"),
    Input.RESET: (State.LISTENING, "nothing"),
    Input.EXPIRED: (State.LISTENING, "try_again"),
    Input.GAVE_UP: (State.IDLE, "give_up"),
}
_OPEN: dict[Input, Entry] = {
    Input.RESET: (State.LISTENING, "nothing"),
    Input.CLOSE: (State.IDLE, "leave"),
    Input.LINK_DOWN: (State.IDLE, "nothing"),
}
# The wrong echo starts over; that of an earlier try, come late, is passed over.
_WRONG: Entry = (State.LISTENING, "nothing")

TABLE: dict[State, dict[Input, Entry]] = {
    State.IDLE: {Input.CONNECT: (State.LISTENING, "listen")},
    State.LISTENING: {
        Input.SIP: (State.HANGING_UP, "hang_up"),
        Input.RESET: (State.LISTENING, "nothing"),
        # A late echo still shows which packet the base expects next.
        Input.ECHO0: (State.SYNC1, "sync1"),
        Input.ECHO1: (State.SYNC2, "sync2"),
        Input.NAMES: (State.CONFIGURING, "open"),
        Input.STRANGER: (State.IDLE, "refuse"),
        Input.EXPIRED: (State.SYNC0, "sync0"),
        Input.GAVE_UP: (State.IDLE, "give_up"),
        Input.CLOSE: (State.IDLE, "nothing"),
        Input.LINK_DOWN: (State.IDLE, "nothing"),
    },
    State.SYNC0: _SYNCING
    | {
        Input.ECHO0: (State.SYNC1, "sync1"),
        Input.ECHO1: _WRONG,
        Input.NAMES: _WRONG,
        Input.STRANGER: _WRONG,
    },
    State.SYNC1: _SYNCING
    | {
        Input.ECHO1: (State.SYNC2, "sync2"),
        Input.NAMES: _WRONG,
        Input.STRANGER: _WRONG,
    },
    State.SYNC2: _SYNCING
    | {
        Input.ECHO0: _WRONG,
        Input.NAMES: (State.CONFIGURING, "open"),
        Input.STRANGER: (State.IDLE, "refuse"),
    },
    State.HANGING_UP: _ENDING
    | {
        Input.RESET: (State.LISTENING, "nothing"),
        Input.EXPIRED: (State.SYNC0, "sync0"),
        Input.GAVE_UP: (State.IDLE, "give_up"),
    },
    State.CONFIGURING: _OPEN
    | {
        Input.SIP: (None, "first_sip"),
        Input.CONFIG: (None, "configure"),
        Input.EXPIRED: (State.CONFIGURING, "ask_again"),
        Input.SETTLED: (State.READY, "be_ready"),
        Input.SLOW: (State.ASKING_FASTER, "ask_faster"),
        Input.GAVE_UP: (State.LISTENING, "nothing"),
    },
    State.ASKING_FASTER: _OPEN | {Input.EXPIRED: (State.FASTER, "switch")},
    State.FASTER: _OPEN
    | {
        Input.SIP: (State.READY, "be_ready"),
        Input.EXPIRED: (State.READY, "switch_back"),
    },
    State.READY: {
        Input.SIP: (State.READY, "publish"),
        Input.CONFIG: (None, "configure"),
        Input.EXPIRED: (State.LOST, "lose"),
        Input.RESET: (State.LISTENING, "lose_to_reset"),
        # Only a base that waits for a client echoes: it took our PULSE for SYNC0.
        Input.ECHO0: (State.LISTENING, "lose_to_reset"),
        Input.CLOSE: (State.IDLE, "leave"),
        Input.LINK_DOWN: (State.IDLE, "lose_line"),
    },
    State.LOST: {
        Input.SIP: (State.READY, "recover"),
        Input.EXPIRED: (State.LISTENING, "listen"),
        Input.RESET: (State.LISTENING, "listen"),
        Input.ECHO0: (State.LISTENING, "listen"),
        Input.CLOSE: (State.IDLE, "leave"),
        Input.LINK_DOWN: (State.IDLE, "nothing"),
    },
}
"""state: {input: (next state or None, action)}; the session's method ``_do_ACTION`` is what is done."""
