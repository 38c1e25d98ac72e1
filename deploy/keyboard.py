"""Driving by keyboard, with a dead-man's switch: no key held means stop. No I/O, no clock.

A terminal reports a held key only by repeating it, after a quarter to two thirds of a second, 10 to 30 times
a second. It never reports the release of a key. Rules of this file:

1. A key counts for `HOLD_S` after it was last read. Then the command is zero.
2. A single key drives at `NUDGE` of the speed, and at full speed from its first repeat on.
3. Any other key stops the rover at once. `teleop.py` discards stale keys.
4. A key is one character or one whole sequence, which may arrive in parts. A part of a sequence is no key:
   Shift+Enter is ``ESC [ 1 3 ; 2 u`` in many terminals, and that u does not drive. Sequences are those of
   ECMA-48 in 7 and 8 bits, mouse reports, function keys of the Linux console, Alt with a key, pasted text.
"""

import re
from enum import StrEnum

from rover_ncp.core.geometry import STANDSTILL, Velocity

HOLD_S = 0.4
NUDGE = 0.5
V_M_S, OMEGA_RAD_S = 0.12, 0.14
"""Three quarters of what the circuits' motors can do, so that a recorded drive makes a course."""

# The place of a key is the direction of the drive, as in ROS's teleop_twist_keyboard; arrows alike.
KEYS: dict[str, tuple[int, int]] = {
    "u": (1, 1),
    "i": (1, 0),
    "o": (1, -1),
    "j": (0, 1),
    "l": (0, -1),
    "m": (-1, -1),
    ",": (-1, 0),
    ".": (-1, 1),
    "\x1b[a": (1, 0),
    "\x1b[b": (-1, 0),
    "\x1b[c": (0, -1),
    "\x1b[d": (0, 1),
}
"""Share of speed and share of turn rate (left is positive) of each key; arrows in small letters."""
QUIT = frozenset("qQ\x03\x04\x1a")
"""q, and Ctrl-C, Ctrl-D, Ctrl-Z where the terminal hands them on."""
HELP = """hold a key to drive, release it to stop:
    u i o     forward: left, straight, right
    j k l     turn left, stop, turn right
    m , .     backward: left, straight, right
the arrows do as i , j l; q or Ctrl-C ends"""

_ARROW = re.compile(r"\x1b[\[O]([A-D])")
# Introducers in 8 bits are one character, or a byte that is no UTF-8, which is decoded to a surrogate.
_CSI, _SS3 = r"(?:\x1b\[|[\x9b\udc9b])", r"(?:\x1b[NO]|[\x8e\x8f\udc8e\udc8f])"
_STRING = r"(?:\x1b[PX\]^_]|[\x90\x98\x9d-\x9f\udc90\udc98\udc9d-\udc9f])"
_CANCELS = r"\x03\x04\x18\x1a\x1b"
_SEQUENCE = re.compile(
    rf"\x1b*?(?:{_CSI}(?:M(?:[^\x1b]{{3}}|[^\x1b]{{0,2}}(?=\x1b))|\[.|(?![M\[])[ -?]*(?:[@-~]|(?=[^ -~])))"
    rf"|{_SS3}[0-?]*[^0-?]"
    rf"|{_STRING}[^\x07\x9c\udc9c{_CANCELS}]*(?:[\x07\x9c\udc9c]|\x1b\\|(?=[{_CANCELS}]))"
    r"|\x1b[ -/]+[^ -/]"
    r"|\x1b[^\x1b\[NOPX\]^_ -/])",
    re.DOTALL,
)
_INTRODUCER = re.compile(rf"\x1b|{_CSI}|{_SS3}|{_STRING}")
_PASTE_BEGIN, _PASTE_END = re.compile(rf"\x1b*?{_CSI}200~"), re.compile(rf"{_CSI}201~")
_PASTE_END_LENGTH = 6
_KEPT, _KEPT_LONG = 64, 3
"""A beginning of a sequence is kept; of one that is longer, the first characters, which make no key."""


class Press(StrEnum):
    """Meaning of a key that does not drive."""

    STOP = "stop"
    QUIT = "quit"


class KeyReader:
    """Splits the text of one terminal into keys."""

    def __init__(self) -> None:
        self._rest = ""
        """The beginning of a sequence whose end has not arrived."""
        self._pasting = False

    def keys(self, text: str) -> list[str]:
        """Return the keys in the terminal's next text: `KEYS`, or what they mean by `Press`.

        Keys in one text with keys that stop do not drive: it may be pasted text that the terminal does not
        mark. The beginning of a sequence stops, too.
        """
        found: list[str] = []
        self._rest += text
        while self._rest and (key := self._next()):
            found.append(key)
        if self._rest or self._pasting:
            found.append(Press.STOP)
        if Press.STOP in found:
            return [key if key is Press.QUIT else Press.STOP for key in found]
        return found

    def _next(self) -> str | None:
        """Take the next key off the text; None if its end has not arrived."""
        rest = self._rest
        if begin := None if self._pasting else _PASTE_BEGIN.match(rest):
            self._pasting, rest = True, rest[begin.end() :]
        if self._pasting:
            end = _PASTE_END.search(rest)
            self._pasting = end is None
            self._rest = rest[end.end() :] if end else rest[-_PASTE_END_LENGTH:]
            return Press.STOP if end else None
        sequence = _SEQUENCE.match(rest)
        if sequence is None and _INTRODUCER.match(rest):
            self._rest = rest if len(rest) <= _KEPT else rest[:_KEPT_LONG]
            return None
        unit = sequence[0] if sequence else rest[0]
        self._rest = rest[len(unit) :]
        return _meaning(unit)


def _meaning(unit: str) -> str:
    if unit in QUIT or (len(unit) == 2 and unit[1] in QUIT):  # also with Alt: to end is safe
        return Press.QUIT
    if arrow := _ARROW.fullmatch(unit):
        return f"\x1b[{arrow[1].lower()}"
    key = unit.lower()
    return key if len(unit) == 1 and key in KEYS else Press.STOP


class Keyboard:
    """The key that is held, and its command. Times are seconds on one clock."""

    def __init__(self) -> None:
        self._key = ""
        self._at = float("-inf")
        self._repeats = False

    def press(self, key: str, now: float) -> None:
        """Take in a key that was read at ``now``."""
        if key not in KEYS:
            self.release()
            return
        # Changing from one held key to another continues the drive; it is not a new press.
        self._repeats = now - self._at <= HOLD_S
        self._key, self._at = key, now

    def release(self) -> None:
        """Clear the key: the rover stands from now on."""
        self._key, self._at, self._repeats = "", float("-inf"), False

    def velocity(self, now: float) -> Velocity:
        """Return the commanded velocity at ``now``."""
        if not self._key or not 0.0 <= now - self._at <= HOLD_S:
            return STANDSTILL
        forward, turn = KEYS[self._key]
        share = 1.0 if self._repeats else NUDGE
        return Velocity(share * V_M_S * forward, share * OMEGA_RAD_S * turn)
