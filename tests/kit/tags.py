"""Tags on a wall, and the picture that a camera on the rover takes of them."""

import math

import numpy as np

from deploy.tag.tag_map import CameraFile, Intrinsics, Mount, Tag, TagMap
from sim.camera.render import PictureErrors, Renderer

PICTURE = Intrinsics(width=640, height=480, fx=500.0, fy=500.0, cx=319.5, cy=239.5)
CAMERA = CameraFile(intrinsics=PICTURE, mount=Mount(x=0.1, y=0.02, z=0.3, yaw=0.05, pitch=0.04))
WALL = TagMap(
    tags=tuple(
        Tag(id=tag, size=0.14, x=2.0, y=y, z=0.3, yaw=math.pi) for tag, y in ((7, 0.2), (8, -0.2), (9, 0.0))
    )
)


def picture_of(pose, camera=CAMERA, tag_map=WALL, *, seed=1, errors=None):
    """Return the picture that is taken from a pose of the base."""
    return Renderer(camera, tag_map, np.random.default_rng(seed), errors or PictureErrors()).picture(pose)
