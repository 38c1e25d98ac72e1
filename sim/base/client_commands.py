"""Commands of clients as a base reads them: those of the bridge, and those that only other clients send.

Sources: ARIA's ArCommands (facts only); the Adept Pioneer 3 manual p. 37, 38; recorded clients.
"""

import struct
from enum import IntEnum

from bridge.pioneer.framing import NEGATIVE, POSITIVE, Command

STRING = 0x2B
"""Type byte of a string."""


class MockCommand(IntEnum):
    """Commands with an effect on the mock, beside those of the bridge. Units: mm, deg, deg/s, decivolts."""

    POLLING = 3  # sonar firing sequence, sonar number + 1 per byte
    MOVE = 8
    ROTATE = 9
    HEAD = 12
    DHEAD = 13
    ENCODER = 19  # 0 stop, 1 one packet, 2 a stream; IOREQUEST and SIM_STAT alike
    DCHEAD = 22  # relative to the last heading setpoint
    DIGOUT = 30  # high byte mask, low byte states
    VEL2 = 32  # high byte left wheel, low byte right, each signed, 20 mm/s
    ADSEL = 35
    IOREQUEST = 40
    SONARCYCLE = 48
    E_STALL = 56
    QSTOP = 57
    SIM_SET_POSE = 224  # mm, mm, deg; simulators only, as the next two
    SIM_RESET = 225
    SIM_STAT = 237
    BATTEST = 250
    RESET = 253


IGNORED = frozenset(
    {
        # SAY, JOYREQUEST, SETRVDIR, SHUTDOWN, GRIPPER, GRIPPERVAL, GRIPREQUEST, GYROCALCW, GYROCALCCW,
        *(15, 17, 20, 25, 33, 36, 37, 38, 39),
        # TTY2, GETAUX, BUMPSTALL, TCM2, JOYDRIVE, AUX1BAUD, AUX2BAUD, AUX3BAUD, TTY4, GETAUX3, BATTERYINFO,
        *(42, 43, 44, 45, 47, 51, 52, 53, 60, 61, 62),
        # TTY3, GETAUX2, CHARGE, ROTKP to TRANSKI, REVCOUNT, DRIFTFACTOR, SOUND, PLAYLIST, SOUNDTOG, TICKSMM,
        *(66, 67, 68, *range(82, 94)),
        # simulators' own: model, laser range finder, control, message, exit; tests; MAINTENANCE
        *(226, 230, 231, 232, 233, 236, 238, 239, 251, 252, 255),
    }
)
"""Documented commands without an effect on the mock."""

_NO_ARGUMENT = {
    *(Command.PULSE, Command.OPEN, Command.CLOSE, Command.SETO, Command.CONFIG, Command.STOP, Command.E_STOP),
    *(MockCommand.QSTOP, MockCommand.SIM_RESET, MockCommand.RESET),
}
_SIGNED = {
    *(Command.SETA, Command.VEL, Command.RVEL, Command.SETRA, MockCommand.MOVE, MockCommand.ROTATE),
    *(MockCommand.HEAD, MockCommand.DHEAD, MockCommand.DCHEAD, MockCommand.VEL2),
}
"""For these the type byte 0x1B negates the argument; the others ignore it."""


def decode_argument(command: int, payload: bytes) -> int | bytes | tuple[int, int, int] | None:
    """Return a command's argument: an integer (0 where none is expected), a string or a pose (mm, mm, deg).

    None when it is missing, cut short or of another type. Never fails: clients send arguments where none are
    expected and leave out those that are (Player's p2os sends SETO with a type byte and nothing else).
    """
    if command in _NO_ARGUMENT:
        return 0
    if command == MockCommand.SIM_SET_POSE:
        if len(payload) < 13:
            return None
        x, y, theta = struct.unpack_from("<3i", payload, 1)
        return x, y, theta
    if command == MockCommand.POLLING:
        return _decode_string(payload)
    if len(payload) < 3 or payload[0] not in (POSITIVE, NEGATIVE):
        return 1 if command == MockCommand.SIM_STAT else None  # ARIA sends SIM_STAT without an argument
    magnitude = payload[1] | payload[2] << 8
    return -magnitude if payload[0] == NEGATIVE and command in _SIGNED else magnitude


def _decode_string(payload: bytes) -> bytes | None:
    """ARIA sends length and bytes, perhaps a NUL more; Soar sends bytes and a NUL without a length."""
    if len(payload) < 2 or payload[0] != STRING:
        return None
    length, rest = payload[1], payload[2:]
    if len(rest) == length or (len(rest) == length + 1 and rest[-1] == 0):
        return rest[:length]
    return payload[1:].split(b"\0")[0]


def pair(word: int) -> tuple[int, int]:
    """Split an integer into its high and low byte, each signed: VEL2's left and right wheel.

    >>> pair(-1275)
    (-5, 5)
    """
    high, low = struct.unpack(">bb", struct.pack(">H", word & 0xFFFF))
    return high, low
