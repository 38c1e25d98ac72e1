"""A camera on the rover that sees tags at a place: a noise model of the poses that it gives.

The tags lie at the place's far end. The camera measures distance, bearing and the tags' turn; their errors
grow with the square of the distance, because the tags' size in the image shrinks. The position of the base
follows from all three, so that an error of the turn moves it sideways. It sees nothing when the tags are out
of its image or too near.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rover_ncp.core.geometry import Pose, compose, relative, wrap_angle
from rover_ncp.wire.messages import pose_with_covariance
from sim.stack.camera import PoseSource
from sim.world.rover import Rover


class DockCamera(Protocol):
    """A camera that sees tags at a place: by a noise model (`TagCamera`), or in rendered pictures."""

    @property
    def tags_ahead_m(self) -> float:
        """How far the tags are ahead of a docked base's middle."""

    def localiser(
        self,
        rover: Rover,
        place: Pose,
        stream: np.random.Generator,
        send: Callable[[bytes, int], None],
        *,
        frame: str,
        backward: bool,
    ) -> PoseSource:
        """Return the localiser of one rover; ``stream`` draws noise, ``send`` gets messages."""


@dataclass(frozen=True)
class TagCamera:
    """Rate, delay, image and errors; standard deviations at 0 m, and their growth up to 3 m."""

    hz: float = 8.0
    delay_s: float = 0.12
    half_view_rad: float = math.radians(40.0)
    nearest_m: float = 0.15
    farthest_m: float = 4.0
    steepest_rad: float = math.radians(75.0)
    """Largest angle between the tags' normal and the line to the camera."""
    tags_ahead_m: float = 0.35
    """How far the tags are ahead of a docked base's middle."""
    distance_m: tuple[float, float] = (0.001, 0.02)
    bearing_rad: tuple[float, float] = (0.0008, 0.0)
    turn_rad: tuple[float, float] = (0.002, math.radians(0.69))
    """Up to 2 m above those of rendered pictures, beyond about equal: ``benchmarks/tag_noise.py``."""
    lost: float = 0.05
    """Share of images without a pose."""

    def localiser(
        self,
        rover: Rover,
        place: Pose,
        stream: np.random.Generator,
        send: Callable[[bytes, int], None],
        *,
        frame: str,
        backward: bool,
    ) -> "TagLocaliser":
        """Return the localiser of one rover."""
        return TagLocaliser(self, rover, place, stream, send, frame=frame, backward=backward)


FULL_M = 3.0
"""Distance at which the growth of the errors counts in full."""


class TagLocaliser(PoseSource):
    """Sends the pose of one rover as its camera measures it."""

    def __init__(
        self,
        camera: TagCamera,
        rover: Rover,
        place: Pose,
        stream: np.random.Generator,
        send: Callable[[bytes, int], None],
        *,
        frame: str,
        backward: bool = False,
    ) -> None:
        super().__init__(camera.hz, camera.delay_s, stream, send)
        self._camera, self._rover, self._frame = camera, rover, frame
        self._looks = math.pi if backward else 0.0
        """Where the camera looks, from the rover's heading."""
        self._tags = compose(place, Pose(0.0, 0.0, self._looks))
        self._tags = compose(self._tags, Pose(camera.tags_ahead_m, 0.0, 0.0))

    def measure(self, wall_ns: int) -> bytes | None:
        """Return the pose by the noise model."""
        camera = self._camera
        eye = compose(self._rover.pose, Pose(0.0, 0.0, self._looks))
        x, y, turn = relative(eye, self._tags)
        distance, bearing = math.hypot(x, y), math.atan2(y, x)
        seen = camera.nearest_m <= distance <= camera.farthest_m and abs(bearing) <= camera.half_view_rad
        errors, lost = self._stream.normal(size=3), self._stream.uniform() < camera.lost
        aside = relative(self._tags, eye)
        if not seen or lost or abs(math.atan2(aside.y, -aside.x)) > camera.steepest_rad:
            return None
        growth = (distance / FULL_M) ** 2
        pairs = (camera.distance_m, camera.bearing_rad, camera.turn_rad)
        sigmas = np.array([near + grown * growth for near, grown in pairs])
        measured = np.array([distance, bearing, turn]) + errors * sigmas
        pose = self._base(measured)
        jacobian = np.empty((3, 3))
        for column, step in enumerate(np.diag(sigmas)):
            ahead, behind = np.array(self._base(measured + step)), np.array(self._base(measured - step))
            moved = ahead - behind
            moved[2] = wrap_angle(moved[2])
            jacobian[:, column] = 0.5 * moved
        covariance: NDArray[np.float64] = jacobian @ jacobian.T
        return pose_with_covariance(pose, covariance + 1e-9 * np.eye(3), wall_ns, self._frame)

    def _base(self, measured: NDArray[np.float64]) -> Pose:
        """Return the pose of the base from distance, bearing and turn of the tags."""
        distance, bearing, turn = measured.tolist()
        seen = Pose(distance * math.cos(bearing), distance * math.sin(bearing), turn)
        eye = compose(self._tags, relative(seen, Pose(0.0, 0.0, 0.0)))
        return compose(eye, Pose(0.0, 0.0, -self._looks))
