"""ARCOS frames, which travel between a computer and a Pioneer base, and the commands of the bridge.

A frame is ``FA FB COUNT KIND payload checksum``; COUNT is the number of bytes after itself, so payload + 3.
Integers are little-endian, the checksum alone is big-endian. A base's packets carry two's complement; a
client's integer arguments carry a sign in their type byte and a magnitude. Nothing is acknowledged, nothing
is repeated, nothing is escaped: ``FA FB`` may stand inside a payload.

Sources: Adept Pioneer 3 manual p. 33 (frame, handshake), AROS manual p. 40, 43, 55 (arguments, examples),
ARIA's ArRobotPacket* and ArCommands (commands; facts only). Byte streams of third-party clients and robots
are in ``tests/data/arcos``; the tests hold this file against them.
"""

import struct
from enum import IntEnum
from typing import NamedTuple

HEADER = b"\xfa\xfb"
MIN_COUNT, MAX_COUNT = 3, 252
"""COUNT is unsigned: a real CONFIGpac has 137. The manuals say up to 249, receive buffers allow more."""
MAX_MAGNITUDE = 32767
"""Largest integer argument, either sign."""
POSITIVE, NEGATIVE = 0x3B, 0x1B
"""Type bytes of integer arguments."""
HOSTBAUD_RATES = (9600, 19200, 38400, 57600, 115200)
"""Rates of a serial line by the argument of HOSTBAUD."""
PAUSE_S = 0.05
"""A sender writes each frame at once. One that pauses for longer may have a damaged COUNT (see Decoder)."""


class Packet(NamedTuple):
    """A frame that passed its checksum: command number or packet type, and what follows it."""

    kind: int
    payload: bytes = b""


class Command(IntEnum):
    """Client commands that the bridge sends. Units: mm, mm/s, mm/s², deg/s, deg/s²."""

    PULSE = 0  # also SYNC0
    OPEN = 1  # also SYNC1
    CLOSE = 2  # also SYNC2
    ENABLE = 4
    SETA = 5  # + acceleration, − deceleration
    SETV = 6
    SETO = 7
    SETRV = 10
    VEL = 11
    CONFIG = 18
    RVEL = 21
    SETRA = 23
    SONAR = 28  # bit 0 on or off, bits 1 to 3 the array, 0 for all
    STOP = 29
    HOSTBAUD = 50  # index into HOSTBAUD_RATES
    E_STOP = 55
    GYRO = 58


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


def encode_command(command: int, argument: int | None = None) -> bytes:
    """Return the frame of a command with an integer argument; None sends none.

    Raises ValueError when the magnitude exceeds 32767.
    """
    if argument is None:
        return encode_frame(command)
    if abs(argument) > MAX_MAGNITUDE:
        raise ValueError(f"command {command} carries at most {MAX_MAGNITUDE}, got {argument}")
    sign = NEGATIVE if argument < 0 else POSITIVE
    return encode_frame(command, struct.pack("<BH", sign, abs(argument)))


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
