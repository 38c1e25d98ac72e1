"""The mock Pioneer with recorded third-party clients."""

import math
import struct

import pytest
from kit.arcos_captures import CAPTURES, Capture
from kit.pioneer_bench import Pioneer

from bridge.pioneer.odometry import ROBOTS


def set_points_by_hand(chunks: list[tuple[float, bytes]]) -> list[tuple[float, float, float]]:
    """Read a client's speeds without our codec: (time, m/s, rad/s) after each VEL, RVEL and VEL2."""
    stream = [(t, byte) for t, data in chunks for byte in data]
    v = omega = 0.0
    points = []
    while stream:
        t, count = stream[2][0], stream[2][1]
        frame, stream = [byte for _, byte in stream[: count + 3]], stream[count + 3 :]
        number, arguments = frame[3], frame[4:-2]
        if number in (11, 21, 32):
            value = int.from_bytes(bytes(arguments[1:3]), "little") * (-1 if arguments[0] == 0x1B else 1)
            if number == 11:
                v = value / 1000
            elif number == 21:
                omega = math.radians(value)
            else:
                right, left = (
                    0.02 * speed for speed in struct.unpack("2b", struct.pack("<H", value % 65536))
                )
                v, omega = (left + right) / 2, (right - left) / 2 / ROBOTS["p3at"].half_track_m
            points.append((t, v, omega))
    return points


@pytest.mark.parametrize("capture", CAPTURES, ids=lambda c: c.name)
def test_every_byte_that_third_party_clients_sent_is_understood(capture: Capture) -> None:
    """All of a client's side leads to the client's setpoints."""
    pioneer, setpoints = Pioneer(capture.model), set_points_by_hand(capture.chunks("c2r"))
    for t, data in capture.chunks("c2r"):
        pioneer.now = t
        pioneer.say(data)
        wanted = next(((v, omega) for when, v, omega in reversed(setpoints) if when <= t), (0.0, 0.0))
        drive = pioneer.firmware.drive
        assert not drive.enabled or (drive._v, drive._omega) == pytest.approx(wanted)
    firmware = pioneer.firmware
    assert not (firmware.unknown or firmware.bad_arguments or firmware.decoder.skipped_bytes)
