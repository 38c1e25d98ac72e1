"""Driving by keyboard, with a dead-man's switch: no key held means stop. No I/O, no clock.

A terminal reports a held key only by sending it again: once, then nothing for a quarter to two thirds of a
second, then again 10 to 30 times a second. It never reports the release of a key. So:

1. A key counts for `HOLD_S` from the moment it was last read, and no longer. Then the command is zero.
2. A single key drives at `NUDGE` of the speed: a short press is a small step. From its first repeat on it
   drives at full speed. Where a terminal waits longer than `HOLD_S` before it repeats, the rover stands until
   then.
3. Any other key stops the rover at once.
4. Keys that were read late are stale and discarded (`teleop.py`).
"""

from enum import StrEnum

from rover_ncp.core.geometry import Velocity

HOLD_S = 0.4
NUDGE = 0.5
V_M_S, OMEGA_RAD_S = 0.12, 0.14
"""Three quarters of what the circuits' motors can do, so that a recorded drive makes a course."""
STANDSTILL = Velocity(0.0, 0.0)

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
"""Share of speed and share of turn rate (left is positive) of each key."""
QUIT = frozenset("q\x03\x04\x1a")
"""q, and Ctrl-C, Ctrl-D, Ctrl-Z where the terminal hands them on."""
HELP = """hold a key to drive, release it to stop:
    u i o     forward: left, straight, right
    j k l     turn left, stop, turn right
    m , .     backward: left, straight, right
the arrows do as i , j l; q or Ctrl-C ends"""

_ESCAPE = "\x1b"


class Press(StrEnum):
    """Meaning of a key that does not drive."""

    STOP = "stop"
    QUIT = "quit"


def presses(text: str) -> list[str]:
    """Split what a terminal sent into keys: `KEYS`, or what they mean by `Press`."""
    # Some terminals send ESC O A for ESC [ A; the shift key has no effect.
    rest, found = text.lower().replace("\x1bo", "\x1b["), []
    while rest:
        key = rest[:3] if rest.startswith(_ESCAPE) else rest[0]
        rest = rest[len(key) :]
        found.append(Press.QUIT if key in QUIT else key if key in KEYS else Press.STOP)
    return found


class Keyboard:
    """The key that is held, and its command. Times are seconds on one clock."""

    def __init__(self) -> None:
        self._key = ""
        self._at = float("-inf")
        self._repeats = False
        self.count = 0
        """Keys that drove."""

    def press(self, key: str, now: float) -> None:
        """Take in a key that was read at ``now``."""
        if key not in KEYS:
            self.release()
            return
        # Changing from one held key to another continues the drive; it is not a new press.
        self._repeats = now - self._at <= HOLD_S
        self._key, self._at = key, now
        self.count += 1

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
