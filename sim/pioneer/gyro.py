"""The gyro of a base that has one for its client (HasGyro 1), as its readings in a GYROpac."""

import random

from bridge.pioneer.arcos import Packet
from bridge.pioneer.packets import GYRO_RAD_S, GYRO_REST, GyroPac
from sim.world.rover import Rover

READINGS = 4
"""A cycle of 0.1 s, one each 25 ms (ARIA's ArAnalogGyro)."""
OFFSET, NOISE = 7.3, 0.7
"""In units, of 0.954 deg/s each: what it reads beside 512 at rest, and the noise of a reading (chosen)."""
ROOM_C = 25
_MOST = 1023


class Gyro:
    """Turns with the rover's true motion; ``seed`` is that of its noise."""

    def __init__(self, rover: Rover, seed: int = 0) -> None:
        self._rover, self._random = rover, random.Random(seed)
        self._angle, self._at = rover.turned, 0.0
        self.on = False

    def packet(self, now: float) -> Packet:
        """Return the readings since the last packet."""
        angle, seconds = self._rover.turned, now - self._at
        rate = (angle - self._angle) / seconds if seconds > 0 else 0.0
        self._angle, self._at = angle, now
        mean = GYRO_REST + OFFSET - rate / GYRO_RAD_S
        readings = (round(mean + self._random.gauss(0.0, NOISE)) for _ in range(READINGS))
        return GyroPac(tuple((min(max(reading, 0), _MOST), ROOM_C) for reading in readings)).encode()
