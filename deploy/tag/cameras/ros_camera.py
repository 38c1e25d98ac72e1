"""A camera of a ROS 2 robot: images, camera_info and tf_static from the robot's Zenoh router."""

import contextlib
import re
import time
from collections import Counter
from collections.abc import Sequence
from functools import partial
from typing import Any

import cv2
import numpy as np
import zenoh
import zenoh.ext
from scipy.spatial.transform import Rotation

from deploy.tag.cameras.camera import LiveCamera, Picture, decode_picture
from deploy.tag.cameras.camera_info import camera_info
from deploy.tag.cameras.ros_source import RosSource, frame_pose
from deploy.tag.locate import OPTICAL
from deploy.tag.tag_map import MOUNT_FIELDS, CameraFile
from rover_ncp.core.config import validated
from rover_ncp.core.errors import FormatError, UsageError
from rover_ncp.recording.recorded import header_stamp_ns
from rover_ncp.wire.cdr import decode
from rover_ncp.wire.messages import BASE_FRAME

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
LEVELS = {
    "mono8": (1, 0),
    "8UC1": (1, 0),
    "nv12": (1, 0),
    "nv21": (1, 0),
    "yuv422": (2, 1),
    "yuv422_yuy2": (2, 0),
}
"""Encodings with grey levels of their own: bytes of a pixel, and which of them is the level."""
COLOURS = {
    "rgb8": (3, cv2.COLOR_RGB2GRAY),
    "bgr8": (3, cv2.COLOR_BGR2GRAY),
    "8UC3": (3, cv2.COLOR_BGR2GRAY),
    "rgba8": (4, cv2.COLOR_RGBA2GRAY),
    "bgra8": (4, cv2.COLOR_BGRA2GRAY),
    "8UC4": (4, cv2.COLOR_BGRA2GRAY),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2GRAY),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2GRAY),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2GRAY),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2GRAY),
}
"""Encodings of colours: bytes of a pixel, and OpenCV's conversion to grey levels."""
MAX_BYTES = 1 << 26
"""Largest message: a picture of 20 megapixels."""
WAIT_S, POLL_S = 5.0, 0.05
"""Longest wait for camera_info and tf_static."""
NAME_ANOTHER = (
    "name a topic of images by '#image=TOPIC' (on the robot, 'ros2 topic list -t' has topics and types)"
)


class RosCamera(LiveCamera):
    """Images of a topic. Their stamps may be of another clock than ours."""

    def __init__(self, source: str, left_out: Counter[str]) -> None:
        super().__init__(source, left_out)
        where = RosSource.parse(source)
        self._problem = f"no message on '{where.topic}': {NAME_ANOTHER}"
        self._session = where.open()
        self._held = self._session.declare_subscriber(where.key(where.topic), self._take)

    def close(self) -> None:
        """End the session."""
        self._session.close()  # type: ignore[no-untyped-call]

    def _take(self, sample: zenoh.Sample) -> None:
        wall_ns, data = time.time_ns(), sample.payload.to_bytes()
        moment_ns = self.moment_ns(header_stamp_ns(IMAGE, data) or None, wall_ns)
        if moment_ns is not None:
            self.newest.put(partial(read_image, data, moment_ns))


def read_image(data: bytes, wall_ns: int) -> Picture:
    """Decode an Image or a CompressedImage, whatever its topic's name says. Raises ValueError."""
    with contextlib.suppress(FormatError):
        return _read_raw(decode(IMAGE, data, MAX_BYTES), wall_ns)
    try:
        message = decode(COMPRESSED, data, MAX_BYTES)
    except FormatError as error:
        found = f"a message of {len(data)} bytes is neither {IMAGE} nor {COMPRESSED}"
        raise ValueError(f"{found}: {NAME_ANOTHER}") from error
    try:
        return decode_picture(message.data.tobytes(), wall_ns)
    except ValueError as error:
        found = f"a CompressedImage with the format {message.format[:40]!r}"
        raise ValueError(f"{error} ({found}, expected JPEG or PNG of a colour or grey camera)") from error


def _read_raw(message: Any, wall_ns: int) -> Picture:
    if message.encoding not in {*LEVELS, *COLOURS}:
        expected = ", ".join([*LEVELS, *COLOURS])
        raise ValueError(f"an image with the encoding {message.encoding[:40]!r}, expected {expected}")
    channels, code = (LEVELS | COLOURS)[message.encoding]
    height, width, step = message.height, message.width, message.step
    if not height * width or step < width * channels or len(message.data) < step * height:
        raise ValueError(f"an image of {width} × {height} pixels has {len(message.data)} bytes")
    rows = message.data[: step * height].reshape(height, step)[:, : width * channels]
    pixels = np.ascontiguousarray(rows).reshape(height, width, channels)
    grey = pixels[:, :, code] if message.encoding in LEVELS else cv2.cvtColor(pixels, code)
    return Picture(np.ascontiguousarray(grey, np.uint8), wall_ns)


def ros_camera_file(source: str) -> CameraFile:
    """Return intrinsics from camera_info and the mount from tf_static. Raises UsageError without them."""
    where = RosSource.parse(source)
    folder, _, _ = where.topic.removesuffix("/compressed").rpartition("/")
    about = f"{folder}/camera_info" if folder else "camera_info"
    infos, statics = list[zenoh.Sample](), list[zenoh.Sample]()
    missing = f"no camera_info on '{about}' within {WAIT_S:g} s"
    history = zenoh.ext.HistoryConfig(detect_late_publishers=True)
    with contextlib.closing(where.open()) as session:
        held: list[Any] = [
            zenoh.ext.declare_advanced_subscriber(session, where.key(topic), statics.append, history=history)
            for topic in {"tf_static", f"{where.namespace}/tf_static".lstrip("/")}
        ]
        held.append(session.declare_subscriber(where.key(about), infos.append))
        until = time.monotonic() + WAIT_S
        while time.monotonic() < until:
            time.sleep(POLL_S)
            if infos:
                transforms = [each.payload.to_bytes() for each in statics]
                try:
                    return camera_file_of(
                        infos[-1].payload.to_bytes(), transforms, rectified=is_rectified(where.topic)
                    )
                except FormatError as error:
                    missing = str(error)
    raise UsageError(f"camera {source}: {missing}; give --camera-file, with what is missing")


def is_rectified(topic: str) -> bool:
    """Whether a topic's images are rectified, by its name: ``image_rect`` is image_proc's."""
    return re.search(r"(^|[/_])rect(_|/|$)", topic) is not None


def camera_file_of(info: bytes, statics: Sequence[bytes], *, rectified: bool = False) -> CameraFile:
    """Return a camera from its CameraInfo and the transforms of tf_static.

    A ``rectified`` image has the matrix P, no distortion, and axes that R turns (sensor_msgs/CameraInfo).

    Raises FormatError if they are no messages of these types, or lead from the base to no camera, and
    ConfigError for intrinsics that cannot be used.
    """
    message = decode(CAMERA_INFO, info)
    size, model = (int(message.width), int(message.height)), str(message.distortion_model)
    k, d, turn = message.k, message.d, np.eye(3)
    if rectified:
        k, d = message.p.reshape(3, 4)[:, :3].ravel(), d[:0]
        turn = message.r.reshape(3, 3) if message.r.any() else turn
    intrinsics = camera_info(size, k.tolist(), model, d.tolist(), "camera_info")
    pose = frame_pose(statics, BASE_FRAME, message.header.frame_id)
    turns = Rotation.from_matrix(pose[:3, :3] @ turn.T @ OPTICAL.T).as_euler("ZYX")
    mount = dict(zip(MOUNT_FIELDS, [*pose[:3, 3].tolist(), *turns.tolist()], strict=True))
    return validated({"intrinsics": intrinsics, "mount": mount}, CameraFile, "tf_static")
