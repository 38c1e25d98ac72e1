"""A camera on the rover whose pictures of tags are rendered, and the poses found in them."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from deploy.tag.camera import Picture
from deploy.tag.localiser import Localiser
from deploy.tag.tag_map import CameraFile, Mount, TagMap, load_camera, load_tag_map
from rover_ncp.core.files import resolve
from rover_ncp.core.geometry import Pose, compose
from rover_ncp.wire.messages import pose_with_covariance
from sim.camera.render import Renderer
from sim.stack.camera import PoseSource
from sim.world.rover import Rover

PLACE_M = 1.6
"""Place of `park --dock` on the x axis of its tags' file."""


@dataclass(frozen=True)
class RenderedCamera:
    """The camera and the tags of `park --dock`, at any place."""

    hz: float = 8.0
    delay_s: float = 0.12
    tags_ahead_m: float = 0.7
    """How far the tags are ahead of a docked base's middle."""

    @cached_property
    def files(self) -> tuple[CameraFile, TagMap]:
        """The camera, and the tags in the frame of `park --dock`."""
        return load_camera(resolve("dock", "camera")), load_tag_map(resolve("dock", "tags"))

    def localiser(
        self,
        rover: Rover,
        place: Pose,
        stream: np.random.Generator,
        send: Callable[[bytes, int], None],
        *,
        frame: str,
        backward: bool,
    ) -> "RenderedLocaliser":
        """Return the localiser of one rover; a rover that backs in has its camera at its rear."""
        (camera, tags), looks = self.files, math.pi if backward else 0.0
        toward = compose(place, Pose(0.0, 0.0, looks))
        moved = tuple(
            tag.model_copy(update=dict(zip(("x", "y", "yaw"), where, strict=True)))
            for tag in tags.tags
            for where in [compose(toward, Pose(tag.x - PLACE_M, tag.y, tag.yaw))]
        )
        side = compose(Pose(0.0, 0.0, looks), Pose(camera.mount.x, camera.mount.y, camera.mount.yaw))
        mount = Mount(x=side.x, y=side.y, z=camera.mount.z, yaw=side.theta)
        settings = (
            camera.model_copy(update={"mount": mount}),
            tags.model_copy(update={"tags": moved, "frame": frame}),
        )
        return RenderedLocaliser(self, settings, rover, stream, send)


class RenderedLocaliser(PoseSource):
    """Sends the poses of one rover that rendered pictures give."""

    def __init__(
        self,
        camera: RenderedCamera,
        settings: tuple[CameraFile, TagMap],
        rover: Rover,
        stream: np.random.Generator,
        send: Callable[[bytes, int], None],
    ) -> None:
        cv2.setNumThreads(1)  # trials run in as many processes as there are processors
        super().__init__(camera.hz, camera.delay_s, stream, send)
        self._rover, self._frame = rover, settings[1].frame
        self._renderer, self._localiser = Renderer(*settings, stream), Localiser(*settings, 2.0)

    def measure(self, wall_ns: int) -> bytes | None:
        """Return the pose that a picture of the present moment gives."""
        found = self._localiser.take(Picture(self._renderer.picture(Pose(*self._rover.pose)), wall_ns))
        if found is None:
            return None
        return pose_with_covariance(found.pose, found.covariance, wall_ns, self._frame)
