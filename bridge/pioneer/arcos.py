"""ARCOS frames and client commands: what travels between a computer and a Pioneer base, both ways.

A frame is ``FA FB COUNT KIND payload checksum``; COUNT is the number of bytes after itself, so payload + 3.
Integers are little-endian, the checksum alone is big-endian. A base's packets carry two's complement; a
client's integer arguments carry a sign in their type byte and a magnitude. Nothing is acknowledged, nothing
is repeated, nothing is escaped: ``FA FB`` may stand inside a payload.

Sources: Adept Pioneer 3 manual p. 33 (frame, handshake), AROS manual p. 40, 43, 55 (arguments, examples),
ARIA's ArRobotPacket* and ArCommands (commands; facts only). Byte streams of third-party clients and robots
are in ``tests/data/arcos``; the tests hold this file against them.
"""

import struct
from enum import Enum, IntEnum
from typing import NamedTuple, Self

HEADER = b"\xfa\xfb"
MIN_COUNT, MAX_COUNT = 3, 252
"""COUNT is unsigned: a real CONFIGpac has 137. The manuals say up to 249, receive buffers allow more."""

MAX_MAGNITUDE = 32767
"""Largest integer argument, either sign."""

POSITIVE, NEGATIVE, STRING = 0x3B, 0x1B, 0x2B
"""Type bytes of arguments."""

PAUSE_S = 0.05
"""A sender writes each frame at once. One that pauses for longer may have a damaged COUNT (see Decoder)."""


class Packet(NamedTuple):
    """A frame that passed its checksum: command number or packet type, and what follows it."""

    kind: int
    payload: bytes = b""


class Argument(Enum):
    """Kind of a command's argument."""

    NONE = "nothing"
    SIGNED = "integer, 0x1B negates it"
    UNSIGNED = "integer, whatever the type byte says"
    STRING = "length and bytes"
    POSE = "an ignored byte, then three 4-byte integers"


_NONE, _INT, _UINT = Argument.NONE, Argument.SIGNED, Argument.UNSIGNED
_STR, _POSE = Argument.STRING, Argument.POSE


class Command(IntEnum):
    """Client commands: number and argument. Units: mm, mm/s, mm/s², deg, deg/s, deg/s², decivolts."""

    argument: Argument

    def __new__(cls, number: int, argument: Argument) -> Self:
        """Make a member that is its number and knows its argument."""
        member = int.__new__(cls, number)
        member._value_ = number
        member.argument = argument
        return member

    PULSE = 0, _NONE  # also SYNC0
    OPEN = 1, _NONE  # also SYNC1
    CLOSE = 2, _NONE  # also SYNC2
    POLLING = 3, _STR  # sonar firing sequence, sonar number + 1 per byte
    ENABLE = 4, _UINT
    SETA = 5, _INT  # + acceleration, − deceleration
    SETV = 6, _UINT
    SETO = 7, _NONE
    MOVE = 8, _INT
    ROTATE = 9, _INT
    SETRV = 10, _UINT
    VEL = 11, _INT
    HEAD = 12, _INT
    DHEAD = 13, _INT
    SAY = 15, _STR
    JOYREQUEST = 17, _UINT
    CONFIG = 18, _NONE
    ENCODER = 19, _UINT  # 0 stop, 1 one packet, 2 a stream; JOYREQUEST and IOREQUEST alike
    SETRVDIR = 20, _INT
    RVEL = 21, _INT
    DCHEAD = 22, _INT  # relative to the last heading asked for
    SETRA = 23, _INT
    SHUTDOWN = 25, _UINT
    SONAR = 28, _UINT  # bit 0 on or off, bits 1 to 3 the array, 0 for all
    STOP = 29, _NONE
    DIGOUT = 30, _UINT  # high byte mask, low byte states
    VEL2 = 32, _INT  # high byte left wheel, low byte right, each signed, 20 mm/s
    GRIPPER = 33, _INT
    ADSEL = 35, _UINT
    GRIPPERVAL = 36, _UINT
    GRIPREQUEST = 37, _UINT
    GYROCALCW = 38, _UINT
    GYROCALCCW = 39, _UINT
    IOREQUEST = 40, _UINT
    TTY2 = 42, _STR
    GETAUX = 43, _UINT
    BUMPSTALL = 44, _UINT  # 0 none, 1 front, 2 rear, 3 either
    TCM2 = 45, _UINT
    JOYDRIVE = 47, _UINT
    SONARCYCLE = 48, _UINT
    HOSTBAUD = 50, _UINT  # 0 to 4: 9600, 19200, 38400, 57600, 115200
    AUX1BAUD = 51, _UINT
    AUX2BAUD = 52, _UINT
    AUX3BAUD = 53, _UINT
    E_STOP = 55, _NONE
    E_STALL = 56, _UINT
    QSTOP = 57, _NONE
    GYRO = 58, _UINT
    TTY4 = 60, _STR
    GETAUX3 = 61, _UINT
    BATTERYINFO = 62, _UINT
    TTY3 = 66, _STR
    GETAUX2 = 67, _UINT
    CHARGE = 68, _UINT
    ROTKP = 82, _UINT
    ROTKV = 83, _UINT
    ROTKI = 84, _UINT
    TRANSKP = 85, _UINT
    TRANSKV = 86, _UINT
    TRANSKI = 87, _UINT
    REVCOUNT = 88, _UINT
    DRIFTFACTOR = 89, _INT
    SOUND = 90, _UINT
    PLAYLIST = 91, _UINT
    SOUNDTOG = 92, _UINT
    TICKSMM = 93, _UINT
    SIM_SET_POSE = 224, _POSE  # mm, mm, deg; simulators only, as all up to SIM_EXIT
    SIM_RESET = 225, _NONE
    SIM_MODEL_CONFIG = 226, _STR
    SIM_LRF_ENABLE = 230, _UINT
    SIM_LRF_FOV_START = 231, _INT
    SIM_LRF_FOV_END = 232, _INT
    SIM_LRF_RES = 233, _UINT
    SIM_CTRL = 236, _UINT
    SIM_STAT = 237, _UINT
    SIM_MESSAGE = 238, _STR
    SIM_EXIT = 239, _INT
    BATTEST = 250, _UINT
    DIGTEMPTEST = 251, _UINT
    SPOOFANALOGTEMP = 252, _INT
    RESET = 253, _NONE
    MAINTENANCE = 255, _NONE


COMMANDS: dict[int, Command] = {int(command): command for command in Command}
"""The commands by their number."""


def checksum(body: bytes | bytearray) -> int:
    """Return the checksum of a frame's bytes from KIND to the payload's end (ARIA's calcCheckSum).

    Byte pairs add up as big-endian words modulo 65536; a byte left over is XORed into the low byte.
    """
    total = sum(body[0:-1:2]) * 256 + sum(body[1::2])
    if len(body) % 2:
        return (total & 0xFFFF) ^ body[-1]
    return total & 0xFFFF


def encode_frame(kind: int, payload: bytes = b"") -> bytes:
    """Return a whole frame. Raises ValueError for a payload of more than 249 bytes."""
    count = len(payload) + 3
    if not 0 <= kind <= 0xFF or count > MAX_COUNT:
        raise ValueError(f"a frame takes a kind of one byte and at most {MAX_COUNT - 3} bytes of payload")
    body = bytes([kind]) + payload
    return HEADER + bytes([count]) + body + struct.pack(">H", checksum(body))


def encode_command(command: Command, argument: int | bytes | tuple[int, int, int] | None = None) -> bytes:
    """Return a command's frame.

    ``argument`` is an integer, the bytes of a string, or a pose (mm, mm, deg), as the command asks; None
    sends none. Raises ValueError when a magnitude exceeds 32767.
    """
    if argument is None:
        return encode_frame(command)
    if isinstance(argument, tuple):
        return encode_frame(command, struct.pack("<x3i", *argument))
    if isinstance(argument, bytes):
        return encode_frame(command, bytes([STRING, len(argument)]) + argument)
    if abs(argument) > MAX_MAGNITUDE:
        raise ValueError(f"{command.name} carries at most {MAX_MAGNITUDE}, got {argument}")
    sign = NEGATIVE if argument < 0 else POSITIVE
    return encode_frame(command, struct.pack("<BH", sign, abs(argument)))


def decode_argument(command: Command, payload: bytes) -> int | bytes | tuple[int, int, int] | None:
    """Return a command's argument, or None when it is missing, cut short or of another type.

    Never fails: clients send arguments where none are expected and leave out those that are (Player's p2os
    sends SETO with a type byte and nothing else).
    """
    match command.argument:
        case Argument.SIGNED | Argument.UNSIGNED:
            if len(payload) < 3 or payload[0] not in (POSITIVE, NEGATIVE):
                return None
            magnitude = payload[1] | payload[2] << 8
            negative = payload[0] == NEGATIVE and command.argument is Argument.SIGNED
            return -magnitude if negative else magnitude
        case Argument.STRING:
            return _decode_string(payload)
        case Argument.POSE:
            if len(payload) < 13:
                return None
            x, y, theta = struct.unpack_from("<3i", payload, 1)
            return x, y, theta
        case _:
            return None


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


class Decoder:
    """Bytes in, packets out. Feed it anything, in any pieces.

    1. Each ``FA`` is a candidate for the start of a frame. Candidates are examined in the order of arrival.
    2. A whole frame with a valid checksum is given out. A candidate that fails is skipped, and the next one
       is sought from the byte after its ``FA``. Damage therefore loses only the packets it touched.
    3. A candidate that is not whole yet withholds all bytes after it, because they may be its payload.
    4. A pause of more than 50 ms ends rule 3 for every candidate that began before it: its COUNT may be
       damaged. Such a candidate can still become whole, but it withholds nothing.

    So a whole valid frame is given out at the latest with the first call after a pause of 50 ms, or when 255
    more bytes have arrived, unless it overlaps a packet already given out.
    """

    def __init__(self) -> None:
        self.packets = 0
        """Valid packets so far."""
        self.bad_checksums = 0
        """Frames with a wrong checksum so far."""
        self.skipped_bytes = 0
        """Bytes so far that belong to no valid packet."""
        self._buffer = bytearray()
        self._last_s = 0.0
        self._before_pause = 0
        """How many bytes of the buffer arrived before the latest pause."""

    def drop(self) -> None:
        """Forget the beginning of a frame: what comes next is another connection's."""
        self.skipped_bytes += len(self._buffer)
        self._buffer.clear()
        self._before_pause = 0

    def feed(self, data: bytes, now: float = 0.0) -> list[Packet]:
        """Return the packets that are given out at ``now`` seconds, when ``data`` arrives.

        Without data, time passes: the caller's timer makes that call at least every 50 ms.
        """
        buffer = self._buffer
        paused = bool(buffer) and now - self._last_s > PAUSE_S
        if paused:
            self._before_pause = len(buffer)
        if data:
            self._last_s = now
            buffer += data
        elif not paused:
            return []
        packets = []
        start = at = failed = 0
        held = -1  # the first candidate from start on that may still become whole
        while (at := buffer.find(HEADER[0], at)) >= 0:
            size = self._size_at(at)
            if size > 0:
                packets.append(Packet(buffer[at + 3], bytes(buffer[at + 4 : at + size - 2])))
                self.skipped_bytes += at - start
                self.bad_checksums += failed
                start = at = at + size
                held, failed = -1, 0
                continue
            if size == 0:
                held = at if held < 0 else held
                if at >= self._before_pause:
                    break
            # A failure behind a held candidate is examined again, and counts when its bytes leave the buffer.
            elif size == _WRONG_SUM:
                if held < 0:
                    self.bad_checksums += 1
                else:
                    failed += 1
            at += 1
        kept = held if held >= 0 else len(buffer)
        self.skipped_bytes += kept - start
        del buffer[:kept]
        self._before_pause = max(self._before_pause - kept, 0)
        self.packets += len(packets)
        return packets

    def _size_at(self, start: int) -> int:
        """Return the size of the valid frame at ``start``, 0 for the beginning of one, or why it is none."""
        head = self._buffer[start : start + 3]
        if head[:2] != HEADER[: len(head)] or (len(head) == 3 and not MIN_COUNT <= head[2] <= MAX_COUNT):
            return _NO_HEADER
        if len(head) < 3 or len(self._buffer) < start + head[2] + 3:
            return 0
        end = start + head[2] + 3
        expected_sum = self._buffer[end - 2] << 8 | self._buffer[end - 1]
        return end - start if checksum(self._buffer[start + 3 : end - 2]) == expected_sum else _WRONG_SUM


_NO_HEADER, _WRONG_SUM = -1, -2
