"""A ROS 2 robot's images, and the place of its camera on it."""

import cv2
import numpy as np
import pytest
from kit.tags import CAMERA, HEADER, INFO, LENS, MAST, PICTURE, compressed_image, image
from scipy.spatial.transform import Rotation

from deploy.tag.cameras.ros_camera import CAMERA_INFO, COMPRESSED, IMAGE, camera_file_of, read_image
from deploy.tag.cameras.ros_source import RosSource
from deploy.tag.locate import OPTICAL
from rover_ncp.core.errors import FormatError, UsageError
from rover_ncp.wire.cdr import encode


@pytest.mark.parametrize(
    ("encoding", "order", "padding"),
    [
        ("mono8", "y", 5),
        ("rgb8", "rgb", 0),
        ("bgr8", "bgr", 3),
        ("yuv422", "uy", 0),
        ("yuv422_yuy2", "yu", 4),
    ],
)
def test_image_of_each_encoding_becomes_grey(encoding, order, padding):
    """The picture is red, of a grey level of 60."""
    levels = {"y": 60, "u": 128, "r": 200, "g": 0, "b": 0, "a": 255}
    row = np.array([levels[each] for each in order] * 4 + [7] * padding, np.uint8)
    data = np.tile(row, 3)
    message = encode(IMAGE, encoding=encoding, height=3, width=4, step=len(row), data=data)
    found = read_image(message, 7)
    assert (found.grey.shape, found.wall_ns) == ((3, 4), 7)
    assert found.grey == pytest.approx(60, abs=1)


def test_compressed_image_is_read_on_a_topic_of_any_name():
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4)
    assert (read_image(compressed_image(grey), 0).grey == grey).all()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (image(np.zeros((2, 2), np.uint8), "mono16"), "'mono16', expected mono8, .*rgb8"),
        (encode(IMAGE, encoding="mono8", height=4, width=4, step=4), "4 × 4 pixels has 0 bytes"),
        (INFO, f"a message of {len(INFO)} bytes is neither"),
        (
            encode(COMPRESSED, format="h264", data=np.ones(9, np.uint8)),
            r"neither a JPEG nor a PNG \(a CompressedImage with the format 'h264', expected JPEG or PNG",
        ),
    ],
)
def test_message_that_is_no_picture_says_why(data, words):
    with pytest.raises(ValueError, match=words):
        read_image(data, 0)


def test_camera_of_ros_has_its_intrinsics_and_its_mount_by_the_frames_up_to_the_base():
    found = camera_file_of(INFO, [MAST, LENS])
    assert found.intrinsics == PICTURE
    assert found.mount.model_dump() == pytest.approx(CAMERA.mount.model_dump())


def test_rectified_image_shows_the_points_where_its_camera_is():
    """The same points, raw and rectified (OpenCV), give the same directions from the base."""
    size, turn = (640, 480), Rotation.from_euler("yx", (0.1, 0.05))
    k, d = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]), np.array([-0.3, 0.1, 0.001, 0.002, 0.0])
    new, _ = cv2.getOptimalNewCameraMatrix(k, d, size, 0.5)
    pixels = np.array([[[100.0, 90]], [[320, 240]], [[500, 400]]])
    moved = cv2.undistortPoints(pixels, k, d, R=turn.as_matrix(), P=new)
    about = {"header": HEADER, "width": size[0], "height": size[1], "distortion_model": "plumb_bob"}
    p = np.hstack([new, [[7.0], [0], [0]]])
    info = encode(CAMERA_INFO, **about, d=d, k=k.ravel(), r=turn.as_matrix().ravel(), p=p.ravel())
    ways = []
    for points, rectified in ((pixels, False), (moved, True)):
        found = camera_file_of(info, [MAST, LENS], rectified=rectified)
        flat = cv2.undistortPoints(points, found.intrinsics.matrix, np.array(found.intrinsics.distortion))
        ahead = cv2.convertPointsToHomogeneous(flat)[:, 0] @ (found.mount.rotation @ OPTICAL).T
        ways.append(ahead / np.linalg.norm(ahead, axis=1)[:, None])
    assert ways[0] == pytest.approx(ways[1], abs=1e-6)


def test_frames_that_do_not_reach_the_base_are_named():
    words = "no transforms from 'base_link' to 'camera_optical', only mast → camera_optical"
    with pytest.raises(FormatError, match=words):
        camera_file_of(INFO, [LENS])


@pytest.mark.parametrize(
    ("source", "key"),
    [
        ("ros2/tcp/robot", "camera/image_raw"),
        ("ros2/tcp/robot:7447#image=/camera/image&namespace=bot/", "bot/camera/image"),
        ("ros2/tcp/robot#rmw=zenoh&domain=7&namespace=bot", "7/bot/camera/image_raw/*/*"),
    ],
)
def test_source_names_router_and_key(source, key):
    where = RosSource.parse(source)
    assert (where.endpoint, where.key(where.topic)) == ("tcp/robot:7447", key)


@pytest.mark.parametrize("source", ["ros2/tcp/robot#rmw=dds", "ros2/tcp/robot#topic=x"])
def test_source_of_another_form_is_refused(source):
    with pytest.raises(UsageError, match=r"expected ros2/tcp/HOST"):
        RosSource.parse(source)
