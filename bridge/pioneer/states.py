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

from bridge.pioneer.framing import Command


class SessionState(Enum):
    """The state of a connection to a base."""

    IDLE = "not connected"
    LISTENING = "listening for an old session"
    SYNC0 = "SYNC0 sent"
    SYNC1 = "SYNC1 sent"
    SYNC2 = "SYNC2 sent"
    HANGING_UP = "closing an old session"
    CONFIGURING = "open, waiting for SIP and CONFIGpac"
    READY = "ready"
    LOST = "no reports from the base"
    ASKING_FASTER = "asked for a faster line"
    FASTER = "at the faster rate, no packet received yet"


class Input(Enum):
    """Inputs of the state machine."""

    CONNECT = "connect was called"
    CLOSE = "close was called"
    LINK_DOWN = "the line is gone"
    EXPIRED = "the state's clock ran out"
    GAVE_UP = "tried often or long enough"
    ECHO0 = "echo of SYNC0"
    ECHO1 = "echo of SYNC1"
    NAMES = "echo of SYNC2 from a base of a known model"
    STRANGER = "echo of SYNC2 from a base of an unknown model"
    SIP = "server information packet"
    CONFIG = "CONFIGpac"
    SETTLED = "SIPs arrive, and the CONFIGpac arrived or its time is over"
    SLOW = "as SETTLED, on a line that could be faster"
    RESET = "notice that the base was reset"


LOSS_S = 0.5
"""Without a SIP for this long a base counts as lost (design, safety requirement 1)."""
PATIENCE_S = {
    SessionState.IDLE: math.inf,
    SessionState.LISTENING: 0.25,  # an open session speaks each 0.1 s
    SessionState.SYNC0: 0.7,  # AMRISim takes up to 0.5 s
    SessionState.SYNC1: 0.7,
    SessionState.SYNC2: 0.7,
    SessionState.HANGING_UP: 0.4,  # as long as Player's p2os waits after CLOSE
    SessionState.CONFIGURING: 0.2,  # ARIA's rhythm of asking for the CONFIGpac
    SessionState.READY: LOSS_S,
    SessionState.LOST: 1.8,  # with LOSS_S longer than the base's watchdog of 2 s: it halts before SYNC0
    SessionState.ASKING_FASTER: 0.05,  # ARIA waits 10 ms; HOSTBAUD's 9 bytes take that long at 9600 alone
    SessionState.FASTER: 0.9,  # as long as ARIA waits for a packet
}
"""How long a state lasts by itself, in seconds."""
CONFIG_S, OPEN_S = 1.0, 2.0
"""Time to wait for a CONFIGpac, which a ready base is asked for again as often, and for the first SIP."""
POLITE_TRIES, SILENT_TRIES = 1, 6
"""Silent handshakes before CLOSE goes first; before giving up."""
TRIES_AGAIN = 3
"""Silent handshakes before giving up a line to a base that was ready before."""
CONNECT_S = 15.0
"""A base that answers but is not ready after this time is given up: the search of both rates takes 8 s."""
FAST_RATE = 38400
"""Rate to ask for on a slower line, as ARIA does: at 9600 a SIP with 16 sonars fills 93 of its 100 ms.

A client that vanished leaves the base at this rate. CLOSE restores the rate in FLASH.
"""
CAN_SWITCH = 2
"""AUTOBAUD of a base that takes another rate in a session (ARIA switches only then)."""
NO_CONFIG = (
    "the base has not sent its configuration (CONFIGpac): its bumpers do not stop the rover before that; "
    "the bridge asks for it once a second"
)
Entry: TypeAlias = tuple[SessionState | None, Command | str | None]

_ENDING: dict[Input, Entry] = {
    Input.CLOSE: (SessionState.IDLE, Command.CLOSE),
    Input.LINK_DOWN: (SessionState.IDLE, None),
}
_SYNCING: dict[Input, Entry] = _ENDING | {
    Input.SIP: (SessionState.HANGING_UP, "hang_up"),
    Input.RESET: (SessionState.LISTENING, None),
    Input.EXPIRED: (SessionState.LISTENING, "try_again"),
    Input.GAVE_UP: (SessionState.IDLE, "give_up"),
}
_OPEN: dict[Input, Entry] = {
    Input.RESET: (SessionState.LISTENING, None),
    Input.CLOSE: (SessionState.IDLE, "leave"),
    Input.LINK_DOWN: (SessionState.IDLE, None),
}
# The wrong echo starts over. A late echo of an earlier try is ignored.
_WRONG: Entry = (SessionState.LISTENING, None)

TABLE: dict[SessionState, dict[Input, Entry]] = {
    SessionState.IDLE: {Input.CONNECT: (SessionState.LISTENING, "listen")},
    SessionState.LISTENING: {
        Input.SIP: (SessionState.HANGING_UP, "hang_up"),
        Input.RESET: (SessionState.LISTENING, None),
        # A late echo still shows which packet the base expects next.
        Input.ECHO0: (SessionState.SYNC1, Command.OPEN),
        Input.ECHO1: (SessionState.SYNC2, Command.CLOSE),
        Input.NAMES: (SessionState.CONFIGURING, "open"),
        Input.STRANGER: (SessionState.IDLE, "refuse"),
        Input.EXPIRED: (SessionState.SYNC0, "sync0"),
        Input.GAVE_UP: (SessionState.IDLE, "give_up"),
        Input.CLOSE: (SessionState.IDLE, None),
        Input.LINK_DOWN: (SessionState.IDLE, None),
    },
    SessionState.SYNC0: _SYNCING
    | {
        Input.ECHO0: (SessionState.SYNC1, Command.OPEN),
        Input.ECHO1: _WRONG,
        Input.NAMES: _WRONG,
        Input.STRANGER: _WRONG,
    },
    SessionState.SYNC1: _SYNCING
    | {
        Input.ECHO1: (SessionState.SYNC2, Command.CLOSE),
        Input.NAMES: _WRONG,
        Input.STRANGER: _WRONG,
    },
    SessionState.SYNC2: _SYNCING
    | {
        Input.ECHO0: _WRONG,
        Input.NAMES: (SessionState.CONFIGURING, "open"),
        Input.STRANGER: (SessionState.IDLE, "refuse"),
    },
    SessionState.HANGING_UP: _ENDING
    | {
        Input.RESET: (SessionState.LISTENING, None),
        Input.EXPIRED: (SessionState.SYNC0, "sync0"),
        Input.GAVE_UP: (SessionState.IDLE, "give_up"),
    },
    SessionState.CONFIGURING: _OPEN
    | {
        Input.SIP: (None, "first_sip"),
        Input.CONFIG: (None, "configure"),
        Input.EXPIRED: (SessionState.CONFIGURING, "ask_again"),
        Input.SETTLED: (SessionState.READY, "be_ready"),
        Input.SLOW: (SessionState.ASKING_FASTER, "ask_faster"),
        Input.GAVE_UP: (SessionState.LISTENING, None),
    },
    SessionState.ASKING_FASTER: _OPEN | {Input.EXPIRED: (SessionState.FASTER, "switch")},
    SessionState.FASTER: _OPEN
    | {
        Input.SIP: (SessionState.READY, "be_ready"),
        Input.EXPIRED: (SessionState.READY, "switch_back"),
    },
    SessionState.READY: _OPEN
    | {
        Input.SIP: (SessionState.READY, "publish"),
        Input.CONFIG: (None, "configure"),
        Input.EXPIRED: (SessionState.LOST, "lose"),
        Input.RESET: (SessionState.LISTENING, "lose_to_reset"),
        # Only a base that waits for a client echoes: it took our PULSE for SYNC0.
        Input.ECHO0: (SessionState.LISTENING, "lose_to_reset"),
        Input.LINK_DOWN: (SessionState.IDLE, "lose_line"),
    },
    SessionState.LOST: _OPEN
    | {
        Input.SIP: (SessionState.READY, "recover"),
        # The line may hold old setpoints back. The base, halted by its watchdog, would obey them later.
        Input.EXPIRED: (SessionState.IDLE, "replace_line"),
        Input.RESET: (SessionState.LISTENING, "listen"),
        Input.ECHO0: (SessionState.LISTENING, "listen"),
    },
}
"""state: {input: (next state or None, action)}; an action is a command, or one of ``Session.ACTIONS``."""
