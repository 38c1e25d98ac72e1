"""A camera on the rover whose pictures of tags are rendered, and the poses found in them."""

from collections.abc import Callable

import cv2
import numpy as np

from deploy.place.place import Place
from deploy.tag.camera import Picture
from deploy.tag.localiser import Localiser
from deploy.tag.tag_map import CameraFile, Mount, TagMap, load_camera, load_tag_map
from rover_ncp.core.files import resolve
from rover_ncp.core.geometry import Pose, compose
from rover_ncp.wire.messages import pose_with_covariance
from sim.camera.render import Renderer
from sim.stack.tag_camera import DockLocaliser
from sim.world.rover import Rover

PLACE_M = 1.6
"""Place of `park --dock` on the x axis of its tags' file."""


class RenderedLocaliser(DockLocaliser):
    """The camera and the tags of `park --dock` at any place.

    A rover that backs in has its camera at its rear. ``known`` are the camera and the map.
    """

    tags_ahead_m = 0.7

    def __init__(
        self,
        rover: Rover,
        place: Place,
        stream: np.random.Generator,
        send: Callable[[bytes, int], None],
    ) -> None:
        cv2.setNumThreads(1)  # trials run in as many processes as there are processors
        super().__init__(rover, place, stream, send)
        self.known = self._placed(
            load_camera(resolve("dock", "camera")), load_tag_map(resolve("dock", "tags"))
        )
        self.renderer, self.localiser = Renderer(*self.known, stream), Localiser(*self.known, 2.0)

    def _placed(self, camera: CameraFile, tags: TagMap) -> tuple[CameraFile, TagMap]:
        moved = tuple(
            tag.model_copy(update=dict(zip(("x", "y", "yaw"), where, strict=True)))
            for tag in tags.tags
            for where in [compose(self._toward, Pose(tag.x - PLACE_M, tag.y, tag.yaw))]
        )
        side = compose(Pose(0.0, 0.0, self._looks), Pose(camera.mount.x, camera.mount.y, camera.mount.yaw))
        mount = Mount(x=side.x, y=side.y, z=camera.mount.z, yaw=side.theta)
        return (
            camera.model_copy(update={"mount": mount}),
            tags.model_copy(update={"tags": moved, "frame": self._frame}),
        )

    def measure(self, wall_ns: int) -> bytes | None:
        """Return the pose that a picture of the present moment gives."""
        found = self.localiser.take(Picture(self.renderer.picture(Pose(*self._rover.pose)), wall_ns))
        if found is None:
            return None
        return pose_with_covariance(found.pose, found.covariance, wall_ns, self._frame)
