"""A camera on the rover whose pictures of tags are rendered, and the poses found in them."""

from collections.abc import Callable

import numpy as np

from deploy.place.place import Place
from deploy.tag.camera import Picture
from deploy.tag.localiser import Localiser
from deploy.tag.tag_map import CameraFile, Mount, TagMap
from rover_ncp.core.config import load_yaml
from rover_ncp.core.files import resolve
from rover_ncp.core.geometry import Pose, compose
from rover_ncp.wire.messages import pose_with_covariance
from sim.camera.render import Renderer
from sim.stack.tag_camera import TagLocaliser
from sim.world.rover import Rover

PLACE_M = 1.6
"""Place of `park --dock` on the x axis of its tags' file."""


class RenderedLocaliser(TagLocaliser):
    """The camera and the tags of `park --dock` at any place.

    A rover that backs in has its camera at its rear. ``known`` are the camera and the map.
    """

    tags_ahead_m = 0.7

    def __init__(
        self, rover: Rover, place: Place, stream: np.random.Generator, send: Callable[[bytes, int], None]
    ) -> None:
        super().__init__(rover, place, stream, send)
        camera, tags = (
            load_yaml(resolve("dock", "camera"), CameraFile),
            load_yaml(resolve("dock", "tags"), TagMap),
        )
        moved = []
        for tag in tags.tags:
            x, y, yaw = compose(self._toward, Pose(tag.x - PLACE_M, tag.y, tag.yaw))
            moved.append(tag.model_copy(update={"x": x, "y": y, "yaw": yaw}))
        x, y, yaw = compose(
            Pose(0.0, 0.0, self._looks), Pose(camera.mount.x, camera.mount.y, camera.mount.yaw)
        )
        self.known = (
            camera.model_copy(update={"mount": Mount(x=x, y=y, z=camera.mount.z, yaw=yaw)}),
            tags.model_copy(update={"tags": tuple(moved), "frame": self._frame}),
        )
        self.renderer, self.localiser = Renderer(*self.known, stream), Localiser(*self.known, 2.0)

    def measure(self, wall_ns: int) -> bytes | None:
        """Return the pose that a picture of the present moment gives."""
        found = self.localiser.take(Picture(self.renderer.picture(Pose(*self._rover.pose)), wall_ns))
        if found is None:
            return None
        return pose_with_covariance(found.pose, found.covariance, wall_ns, self._frame)
