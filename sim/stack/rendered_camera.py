"""A camera on the rover whose pictures of tags are rendered, and the poses found in them."""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

from deploy.place.place import Place
from deploy.place.sight import Sight
from deploy.tag.cameras.camera import Picture
from deploy.tag.field_of_view import sight_of
from deploy.tag.localiser import Localiser
from deploy.tag.locate import Locator
from deploy.tag.tag_map import CameraFile, Mount, TagMap
from rover_ncp.core.config import load_yaml
from rover_ncp.core.files import resolve
from rover_ncp.core.geometry import Pose, compose
from sim.camera.render import Renderer
from sim.stack.tag_camera import TagLocaliser, camera_direction
from sim.world.localiser_errors import LocaliserErrors, Measured
from sim.world.rover import Rover

PLACE_M = 1.6
"""Place of `park --dock` on the x axis of its tags' file."""


class Scene(NamedTuple):
    """The camera and the tags of a room, and what the localiser's files say of them."""

    camera: CameraFile
    tags: TagMap
    camera_file: CameraFile
    map: TagMap


@cache
def dock_camera(place: Place) -> tuple[CameraFile, TagMap]:
    """Return the camera and the tags of `park --dock`, moved to a place.

    A rover that backs in has its camera at its rear.
    """
    camera = load_yaml(resolve("dock", "camera"), CameraFile)
    tags = load_yaml(resolve("dock", "tags"), TagMap)
    direction = camera_direction(place)
    toward, moved = compose(place.goal, direction), []
    for tag in tags.tags:
        x, y, yaw = compose(toward, Pose(tag.x - PLACE_M, tag.y, tag.yaw))
        moved.append(tag.model_copy(update={"x": x, "y": y, "yaw": yaw}))
    x, y, yaw = compose(direction, Pose(camera.mount.x, camera.mount.y, camera.mount.yaw))
    return (
        camera.model_copy(update={"mount": Mount(x=x, y=y, z=camera.mount.z, yaw=yaw)}),
        tags.model_copy(update={"tags": tuple(moved), "frame": place.frame}),
    )


class RenderedLocaliser(TagLocaliser):
    """The camera and the tags of `park --dock` at any place."""

    tags_ahead_m = 0.7

    def __init__(
        self,
        rover: Rover,
        place: Place,
        stream: np.random.Generator,
        send: Callable[[bytes, int], None],
        errors: LocaliserErrors | None = None,
    ) -> None:
        super().__init__(rover, place, stream, send, errors)
        scene = self.scene(place)
        self.frame = scene.map.frame
        self.renderer = Renderer(scene.camera, scene.tags, stream)
        self.localiser = Localiser(scene.camera_file, scene.map)

    @classmethod
    def scene(cls, place: Place) -> Scene:
        """Return the room around a place."""
        return Scene(*dock_camera(place) * 2)

    @classmethod
    def tags_in_view(cls, start: Pose, place: Place) -> int:
        """Return how many tags are wholly in the image."""
        scene = cls.scene(place)
        camera = scene.camera.intrinsics
        locator, size = Locator(scene.camera, scene.tags), np.array((camera.width, camera.height))
        within = 0
        for tag in scene.tags.tags:
            pixels = camera.pixels(locator.project(np.array(start), tag.corners))
            within += bool(np.all((pixels > 0.0) & (pixels < size - 1.0)))
        return within

    @classmethod
    def has_tags(cls, start: Pose, place: Place) -> bool:
        """Return whether two tags are wholly in the image: the pose by one tag can be ambiguous."""
        return cls.tags_in_view(start, place) >= 2

    @classmethod
    def has_none(cls, start: Pose, place: Place) -> bool:
        """Return whether no tag is wholly in the image."""
        return cls.tags_in_view(start, place) == 0

    @classmethod
    def sight(cls, place: Place) -> Sight | None:
        """Return the view of the camera by its file, as for a robot's file with camera and tags."""
        scene = cls.scene(place)
        return sight_of(scene.camera_file, scene.map, cls.taught(place))

    def measure(self, wall_ns: int) -> Measured | None:
        """Return the pose that a picture of the present moment gives."""
        found = self.localiser.take(Picture(self.renderer.picture(Pose(*self._rover.pose)), wall_ns))
        return None if found is None else Measured(found.pose, found.covariance)
