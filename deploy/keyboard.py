"""Driving by keyboard, with a dead-man's switch: no key held means stop. No I/O, no clock.

A terminal reports a held key only by repeating it, after a quarter to two thirds of a second, 10 to 30 times
a second. It never reports the release of a key. Rules of this file:

1. A key counts for `HOLD_S` after it was last read. Then the command is zero.
2. A single key drives at `NUDGE` of the speed, and at full speed from its first repeat on.
3. What a terminal sends at once is one key or repeats of it. Anything else stops the rover, and no key drives
   for `IGNORED_S`: an escape sequence may arrive in parts, and a part of it is no key. Shift+Enter is
   ``ESC [ 1 3 ; 2 u`` in many terminals.
"""

import re

from rover_ncp.core.geometry import STANDSTILL, Velocity

HOLD_S = 0.4
IGNORED_S = 0.1
NUDGE = 0.5
V_M_S, OMEGA_RAD_S = 0.12, 0.14
"""Three quarters of what the circuits' motors can do, so that a recorded drive makes a course."""

_ARROWS = {"A": (1, 0), "B": (-1, 0), "C": (0, -1), "D": (0, 1)}
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
} | {f"\x1b{introducer}{arrow}": way for introducer in "[O" for arrow, way in _ARROWS.items()}
"""Share of speed and share of turn rate (left is positive) of each key; arrows as terminals send them."""
QUIT = frozenset("qQ\x03\x04\x1a")
"""q, and Ctrl-C, Ctrl-D, Ctrl-Z where the terminal hands them on."""
HELP = """hold a key to drive, release it to stop:
    u i o     forward: left, straight, right
    j k l     turn left, stop, turn right
    m , .     backward: left, straight, right
the arrows do as i , j l; q or Ctrl-C ends"""

_REPEATS = re.compile(r"(\x1b[\[O][A-D]|.)\1*", re.DOTALL)


class Keyboard:
    """The key that is held, and its command. Times are seconds on one clock."""

    def __init__(self) -> None:
        self._key = ""
        self._at = self._ignored_until = float("-inf")
        self._repeats = False

    def take(self, text: str, now: float) -> bool:
        """Take in what the terminal sent at ``now``, and return whether it is a key that ends the drive."""
        repeats = _REPEATS.fullmatch(text)
        key = repeats[1] if repeats else ""
        if key in QUIT:
            return True
        key = key if key in KEYS else key.lower() if len(key) == 1 else ""
        if key not in KEYS:
            self.release()
            self._ignored_until = now + IGNORED_S
        elif now >= self._ignored_until:
            # Changing from one held key to another continues the drive; it is not a new press.
            self._repeats = now - self._at <= HOLD_S
            self._key, self._at = key, now
        return False

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
