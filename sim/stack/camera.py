"""External localisation of a simulated rover: a camera with a rate, noise and a delay."""

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rover_ncp.core.geometry import Pose
from rover_ncp.wire.messages import COURSE_FRAME, pose_with_covariance
from sim.stack.lines import NS, WALL_NS
from sim.world.rover import Rover

RAD_PER_M = math.radians(1.0) / 0.02
"""Noise of the heading for a noise of the position: 1 degree for 2 cm."""


KNOWN_M, KNOWN_RAD = 0.001, 0.001
"""Standard deviations of a start pose."""


def start_pose(pose: Pose, wall_ns: int) -> bytes:
    """Return the external pose of a rover that was placed to the millimetre."""
    covariance = np.diag(np.square([KNOWN_M, KNOWN_M, KNOWN_RAD]))
    return pose_with_covariance(pose, covariance, wall_ns, COURSE_FRAME)


@dataclass(frozen=True)
class Camera:
    """Rate, noise and delay of a camera; the noise is the standard deviation of x and of y."""

    hz: float = 5.0
    noise_m: float = 0.02
    delay_s: float = 0.1

    @property
    def noise(self) -> tuple[float, float, float]:
        """Standard deviations of x, y and heading."""
        return self.noise_m, self.noise_m, RAD_PER_M * self.noise_m


class PoseSource(ABC):
    """Measures a rover's pose at a rate, and sends it after a delay. ``stream`` draws noise and phase."""

    def __init__(
        self, hz: float, delay_s: float, stream: np.random.Generator, send: Callable[[bytes, int], None]
    ) -> None:
        self._period_s, self._delay_s, self._stream, self._send = 1.0 / hz, delay_s, stream, send
        self._next_s = float(stream.uniform(0.0, 1.0)) / hz
        self._pending: deque[tuple[float, bytes]] = deque()
        """Arrival times in s, and messages."""

    @abstractmethod
    def measure(self, wall_ns: int) -> bytes | None:
        """Return the present pose as a message with that stamp; None if nothing is seen."""

    def observe(self, now: float) -> None:
        """Measure the rover's pose at ``now`` s if it is due, and deliver what has arrived."""
        if now >= self._next_s:
            self._next_s += self._period_s
            data = self.measure(WALL_NS + round(now * NS))
            if data is not None:
                self._pending.append((now + self._delay_s, data))
        while self._pending and self._pending[0][0] <= now:
            due, data = self._pending.popleft()
            self._send(data, round(due * NS))


class Localiser(PoseSource):
    """Sends the pose of one rover as a camera measures it."""

    def __init__(
        self, camera: Camera, rover: Rover, stream: np.random.Generator, send: Callable[[bytes, int], None]
    ) -> None:
        super().__init__(camera.hz, camera.delay_s, stream, send)
        self._camera, self._rover = camera, rover

    def measure(self, wall_ns: int) -> bytes:
        """Return the pose with the camera's noise."""
        noise = self._camera.noise
        x, y, theta = np.array(self._rover.pose) + self._stream.normal(size=3) * noise
        covariance = np.diag(np.square(noise))
        return pose_with_covariance(Pose(float(x), float(y), float(theta)), covariance, wall_ns, COURSE_FRAME)
