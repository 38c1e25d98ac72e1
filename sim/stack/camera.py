"""External localisation of a simulated rover: a camera with a rate, noise and a delay."""

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable

import numpy as np

from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.geometry import Pose
from rover_ncp.robot.lasting_error import Kind, LastingError
from rover_ncp.wire.messages import COURSE_FRAME, pose_with_covariance
from sim.stack.lines import WALL_NS
from sim.world.localiser_errors import LocaliserErrors, Measured
from sim.world.rover import Rover

KNOWN_M, KNOWN_RAD = 0.001, 0.001
"""Standard deviations of a start pose."""
PLACED = LastingError(kind=Kind.MOTION_CAPTURE)
"""Declaration of the source of start poses, and of the cameras without a lasting error."""


def start_pose(pose: Pose, wall_ns: int) -> bytes:
    """Return the external pose of a rover that was placed to the millimetre."""
    covariance = np.diag(np.square([KNOWN_M, KNOWN_M, KNOWN_RAD]))
    return pose_with_covariance(pose, covariance, wall_ns, COURSE_FRAME)


class PoseSource(ABC):
    """Measures a rover's pose ``hz`` times a second, and sends it ``delay_s`` later.

    ``stream`` draws noise and phase; ``errors`` are those of the trial, if it has any.
    """

    hz: float
    delay_s: float
    frame: str
    usual = PLACED
    """What it declares of its lasting error in a trial without one."""

    def __init__(
        self,
        rover: Rover,
        stream: np.random.Generator,
        send: Callable[[bytes, int], None],
        errors: LocaliserErrors | None = None,
    ) -> None:
        self._rover, self._stream, self._send, self._errors = rover, stream, send, errors
        self._next_s = float(stream.uniform(0.0, 1.0)) / self.hz
        self._pending: deque[tuple[float, bytes]] = deque()
        """Arrival times in s, and messages."""

    @property
    def lasting_error(self) -> LastingError:
        """What it declares of its lasting error."""
        return (self._errors and self._errors.declared) or self.usual

    @abstractmethod
    def measure(self, wall_ns: int) -> Measured | None:
        """Return the present pose, whose stamp is ``wall_ns``; None if nothing is seen."""

    def observe(self, now: float) -> None:
        """Measure the rover's pose at ``now`` s if it is due, and deliver what has arrived."""
        if now >= self._next_s:
            self._next_s += 1.0 / self.hz
            wall_ns = WALL_NS + round(now * NS_PER_S)
            measured = self.measure(wall_ns)
            if measured is not None:
                if self._errors is not None:
                    measured = self._errors.apply(measured, self._rover.pose, now)
                self._pending.append(
                    (now + self.delay_s, pose_with_covariance(*measured, wall_ns, self.frame))
                )
        while self._pending and self._pending[0][0] <= now:
            due, data = self._pending.popleft()
            self._send(data, round(due * NS_PER_S))


class CeilingCamera(PoseSource):
    """A camera that sees the rover on its course."""

    hz, delay_s, frame = 5.0, 0.1, COURSE_FRAME
    noise = 0.02, 0.02, math.radians(1.0)
    """Standard deviations of x, y and heading."""

    def measure(self, wall_ns: int) -> Measured:
        """Return the pose with the camera's noise."""
        x, y, theta = (np.array(self._rover.pose) + self._stream.normal(size=3) * self.noise).tolist()
        return Measured(Pose(x, y, theta), np.diag(np.square(self.noise)))
