"""Tags on a wall, the picture that a camera on the rover takes of them, and both as messages of ROS."""

import math

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from deploy.tag.cameras.ros_camera import CAMERA_INFO, COMPRESSED, IMAGE
from deploy.tag.locate import OPTICAL
from deploy.tag.tag_map import CameraFile, Intrinsics, Mount, Tag, TagMap
from rover_ncp.wire.cdr import encode
from rover_ncp.wire.messages import TF
from sim.camera.render import Renderer

PICTURE = Intrinsics(width=640, height=480, fx=500.0, fy=500.0, cx=319.5, cy=239.5)
CAMERA = CameraFile(intrinsics=PICTURE, mount=Mount(x=0.1, y=0.02, z=0.3, yaw=0.05, pitch=0.04))
WALL = TagMap(
    tags=tuple(
        Tag(id=tag, size=0.14, x=2.0, y=y, z=0.3, yaw=math.pi) for tag, y in ((7, 0.2), (8, -0.2), (9, 0.0))
    )
)


def picture_of(pose, camera=CAMERA, tag_map=WALL, *, seed=1, gain=1.0):
    """Return the picture that is taken from a pose of the base."""
    return Renderer(camera, tag_map, np.random.default_rng(seed), gain).picture(pose)


HEADER = {"stamp": {"sec": 5, "nanosec": 0}, "frame_id": "camera_optical"}


def image(grey, encoding="mono8", padding=0):
    """An Image whose rows end with ``padding`` bytes; colours other than the last are far from the grey."""
    channels = {"mono8": 1, "rgb8": 3, "bgr8": 3}.get(encoding, 1)
    rows = np.repeat(grey[:, :, None], channels, axis=2).reshape(len(grey), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)))
    size = {"height": len(grey), "width": grey.shape[1], "step": rows.shape[1]}
    return encode(IMAGE, header=HEADER, encoding=encoding, data=rows.ravel().astype(np.uint8), **size)


def compressed_image(grey):
    return encode(COMPRESSED, header=HEADER, format="png", data=cv2.imencode(".png", grey)[1].ravel())


def transform(parent, child, shift, turn=None):
    x, y, z, w = (turn or Rotation.identity()).as_quat().tolist()
    placed = {
        "translation": dict(zip("xyz", shift, strict=True)),
        "rotation": {"x": x, "y": y, "z": z, "w": w},
    }
    return encode(
        TF, transforms=[{"header": {"frame_id": parent}, "child_frame_id": child, "transform": placed}]
    )


MAST = transform("base_link", "mast", (0.1, 0.0, 0.0))
LENS = transform(
    "mast", "camera_optical", (0.0, 0.02, 0.3), Rotation.from_matrix(CAMERA.mount.rotation @ OPTICAL)
)
INFO = encode(
    CAMERA_INFO,
    header=HEADER,
    height=PICTURE.height,
    width=PICTURE.width,
    distortion_model="plumb_bob",
    d=np.zeros(5),
    k=PICTURE.matrix.ravel(),
)
