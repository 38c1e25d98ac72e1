"""The base's sonars, with their firing order and echoes, and the gyro of a base that has one for its client.

Two arrays, front (0 to 7) and rear (8 to 15), fire one sonar each per sonar cycle, in turn (POLLING changes
the order). A reading is the distance along the sonar's axis; a real cone has more echoes, and later ones.
"""

import random

from bridge.pioneer.framing import Packet
from bridge.pioneer.packets import GYRO_RAD_S, GYRO_REST, NO_ECHO_MM, Flag, GyroPac
from rover_ncp.core.geometry import compose
from rover_ncp.robot.description import RobotDescription
from sim.world.rover import Rover

ARRAY = 8


class Sonars:
    """The sonars of one base."""

    def __init__(self, robot: RobotDescription, cycle_s: float) -> None:
        self._poses = robot.sonar_poses
        self._flash_cycle_s = cycle_s
        self.restore_flash()

    def restore_flash(self) -> None:
        """Go back to power-up: all on, in their order."""
        self._cycle_s = self._flash_cycle_s
        self._on = [True, True]
        self._order = [list(range(ARRAY)), list(range(ARRAY, 2 * ARRAY))]
        self._turns = [0, 0]
        self._due_s = 0.0
        self._readings: dict[int, int] = {}

    @property
    def flags(self) -> int:
        """Their bits of FLAGS."""
        return (Flag.SONAR_1 if self._on[0] else 0) | (Flag.SONAR_2 if self._on[1] else 0)

    def switch(self, argument: int) -> None:
        """SONAR: bit 0 on or off, bits 1 to 3 the array from 1, 0 for all."""
        array = argument >> 1 & 7
        for index in range(2):
            if array in (0, index + 1):
                self._on[index] = bool(argument & 1)

    def poll(self, sequence: bytes) -> None:
        """POLLING: the sonars to fire, from 1; those left out stay silent. Empty restores the default."""
        numbers = [number - 1 for number in sequence if 1 <= number <= 2 * ARRAY]
        every = numbers or list(range(2 * ARRAY))
        self._order = [[n for n in every if n // ARRAY == index] for index in range(2)]
        self._turns = [0, 0]

    def set_cycle(self, milliseconds: int) -> None:
        """SONARCYCLE; 0 goes back to FLASH."""
        self._cycle_s = milliseconds / 1000 or self._flash_cycle_s

    def fire(self, rover: Rover, now: float) -> None:
        """Fire what is due at ``now``."""
        if now < self._due_s:
            return
        self._due_s = now + self._cycle_s
        for index in range(2):
            order = self._order[index]
            if self._on[index] and order:
                number = order[self._turns[index] % len(order)]
                self._turns[index] += 1
                self._readings[number] = self._range_mm(rover, number)

    def take(self) -> tuple[tuple[int, int], ...]:
        """Return (number, mm) of the readings since the last call."""
        readings, self._readings = self._readings, {}
        return tuple(sorted(readings.items()))

    def _range_mm(self, rover: Rover, number: int) -> int:
        echo_m = rover.range_along(compose(rover.pose, self._poses[number]), NO_ECHO_MM / 1000)
        return NO_ECHO_MM if echo_m is None else round(1000 * echo_m)


READINGS = 4
"""A cycle of 0.1 s, one each 25 ms (ARIA's ArAnalogGyro)."""
OFFSET, NOISE = 7.3, 0.7
"""In units, of 0.954 deg/s each: what it reads beside 512 at rest, and the noise of a reading (chosen)."""
ROOM_C = 25
_MAX_READING = 1023


class TurnMeter:
    """A rover's true mean turn rate between two readings."""

    def __init__(self, rover: Rover, now: float) -> None:
        self._rover, self._angle, self._at = rover, rover.turned, now

    def rate(self, now: float) -> float:
        """Return the mean rate since the last reading, rad/s."""
        angle, seconds = self._rover.turned, now - self._at
        rate = (angle - self._angle) / seconds if seconds > 0 else 0.0
        self._angle, self._at = angle, now
        return rate


class Gyro:
    """Turns with the rover's true motion; ``seed`` is that of its noise."""

    def __init__(self, rover: Rover, now: float, seed: int = 0) -> None:
        self._turns, self._random = TurnMeter(rover, now), random.Random(seed)
        self.on = False
        self.error_rad_s = 0.0
        """How much more it reads, by a fault."""

    def packet(self, now: float) -> Packet:
        """Return the readings since the last packet."""
        rate = self._turns.rate(now)
        mean = GYRO_REST + OFFSET - (rate + self.error_rad_s) / GYRO_RAD_S
        readings = (round(mean + self._random.gauss(0.0, NOISE)) for _ in range(READINGS))
        return GyroPac(tuple((min(max(reading, 0), _MAX_READING), ROOM_C) for reading in readings)).encode()
