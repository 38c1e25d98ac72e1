"""A camera on the rover that sees tags at a place: a noise model of the poses that it gives.

The tags lie at the place's far end. The camera measures distance, bearing and the tags' turn; their errors
grow with the square of the distance, because the tags' size in the image shrinks. The position of the base
follows from all three, so that an error of the turn moves it sideways. It sees nothing when the tags are out
of its image or too near.
"""

import math
from collections.abc import Callable
from typing import ClassVar

import numpy as np

from deploy.place.place import Place
from deploy.place.sight import Sight
from rover_ncp.core.geometry import Pose, compose, relative, wrap_angle
from rover_ncp.robot.lasting_error import Kind, LastingError
from sim.stack.camera import PoseSource
from sim.world.localiser_errors import LocaliserErrors, Measured
from sim.world.rover import Rover

FULL_M = 3.0
"""Distance at which the growth of the errors counts in full."""


def camera_direction(place: Place) -> Pose:
    """Return the direction of the camera in the rover's frame: it looks where the rover enters the place."""
    return Pose(0.0, 0.0, math.pi if place.backward else 0.0)


class TagLocaliser(PoseSource):
    """Poses of one rover from tags at a place, by the camera at that end of the rover which enters it.

    The poses are those of the noise model: standard deviations at 0 m, and their growth up to 3 m.
    """

    hz, delay_s = 8.0, 0.12
    usual = LastingError(kind=Kind.TAGS)
    tags_ahead_m = 0.35
    """How far the tags are ahead of a docked base's middle."""
    half_view_rad = math.radians(40.0)
    nearest_m, farthest_m = 0.15, 4.0
    steepest_rad = math.radians(75.0)
    """Largest angle between the tags' normal and the line to the camera."""
    sigmas: ClassVar = np.array([[0.001, 0.02], [0.0008, 0.0], [0.002, math.radians(0.69)]])
    """Of distance (m), bearing and turn (rad). Up to 2 m above those of rendered pictures, beyond about
    equal: ``benchmarks/tag_noise.py``."""
    lost = 0.05
    """Share of images without a pose."""

    def __init__(
        self,
        rover: Rover,
        place: Place,
        stream: np.random.Generator,
        send: Callable[[bytes, int], None],
        errors: LocaliserErrors | None = None,
    ) -> None:
        super().__init__(rover, stream, send, errors)
        self.frame = place.frame
        self._camera = camera_direction(place)
        self._toward = compose(place.goal, self._camera)
        """The place, turned to where a docked rover's camera looks."""

    @classmethod
    def has_tags(cls, start: Pose, place: Place) -> bool:
        """Return whether the camera has enough tags in its image at a start that a trial drew.

        True here: no trial draws a start at which this camera has none.
        """
        return True

    @classmethod
    def has_none(cls, start: Pose, place: Place) -> bool:
        """Return whether the camera has no tag in its image at a start."""
        raise NotImplementedError

    @classmethod
    def taught(cls, place: Place) -> Place:
        """Return the place as the driver knows it: here the very place."""
        return place

    @classmethod
    def sight(cls, place: Place) -> Sight | None:
        """Return what the driver knows of the camera's view of a taught place: here nothing."""
        return None

    def measure(self, wall_ns: int) -> Measured | None:
        """Return the pose by the noise model."""
        tags = compose(self._toward, Pose(self.tags_ahead_m, 0.0, 0.0))
        eye = compose(self._rover.pose, self._camera)
        x, y, turn = relative(eye, tags)
        distance, bearing = math.hypot(x, y), math.atan2(y, x)
        seen = self.nearest_m <= distance <= self.farthest_m and abs(bearing) <= self.half_view_rad
        errors, lost = self._stream.normal(size=3), self._stream.uniform() < self.lost
        aside = relative(tags, eye)
        if not seen or lost or abs(math.atan2(aside.y, -aside.x)) > self.steepest_rad:
            return None
        sigmas = self.sigmas @ [1.0, (distance / FULL_M) ** 2]
        distance, bearing, turn = (np.array([distance, bearing, turn]) + errors * sigmas).tolist()
        direction = tags.theta - turn + bearing
        ahead, left = distance * math.cos(direction), distance * math.sin(direction)
        theta = wrap_angle(tags.theta - turn - self._camera.theta)
        # How the pose changes with distance, bearing and turn.
        jacobian = np.array(
            [[-ahead / distance, left, -left], [-left / distance, -ahead, ahead], [0.0, 0.0, -1.0]]
        )
        covariance = jacobian * sigmas**2 @ jacobian.T + 1e-9 * np.eye(3)
        return Measured(Pose(tags.x - ahead, tags.y - left, theta), covariance)
