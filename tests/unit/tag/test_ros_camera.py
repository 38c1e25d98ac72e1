"""A ROS 2 robot's images, the place of its camera on it, and poses from its transforms."""

import math
import struct
import zlib

import cv2
import numpy as np
import pytest
from kit.tags import CAMERA, HEADER, INFO, LENS, MAST, PICTURE, image, transform
from scipy.spatial.transform import Rotation

from deploy.tag.locate import OPTICAL
from deploy.tag.relay import TransformPoses
from deploy.tag.ros_camera import CAMERA_INFO, COMPRESSED, IMAGE, camera_file_of, is_rectified, read_image
from deploy.tag.ros_source import RosSource
from rover_ncp.core.errors import ConfigError, FormatError, UsageError
from rover_ncp.wire.cdr import encode
from rover_ncp.wire.messages import TF, Transform, read_pose, transforms


@pytest.mark.parametrize(("encoding", "padding"), [("mono8", 0), ("mono8", 5), ("rgb8", 0), ("bgr8", 3)])
def test_image_of_each_encoding_becomes_grey(encoding, padding):
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4) * 20
    found = read_image(IMAGE, image(grey, encoding, padding), 7)
    assert (found.grey.tolist(), found.wall_ns) == (grey.tolist(), 7)


def test_red_and_blue_are_not_exchanged():
    red = np.zeros((2, 2, 3), np.uint8)
    red[:, :, 0] = 200
    size = {"height": 2, "width": 2, "step": 6}
    levels = {
        encoding: read_image(IMAGE, encode(IMAGE, encoding=encoding, data=red.ravel(), **size), 0).grey[0, 0]
        for encoding in ("rgb8", "bgr8")
    }
    assert levels == {"rgb8": round(0.299 * 200), "bgr8": round(0.114 * 200)}


def too_large():
    """Return a PNG whose header says that it has 40 gigapixels."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    size = struct.pack(">IIBBBBB", 200_000, 200_000, 8, 0, 0, 0, 0)
    data = (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", size)
        + chunk(b"IDAT", zlib.compress(b"0"))
        + chunk(b"IEND", b"")
    )
    return np.frombuffer(data, np.uint8)


@pytest.mark.parametrize(
    ("ros_type", "data", "words"),
    [
        (IMAGE, image(np.zeros((2, 2), np.uint8), "yuv422"), "'yuv422', expected mono8, rgb8, bgr8"),
        (IMAGE, encode(IMAGE, encoding="mono8", height=4, width=4, step=4), "4 × 4 pixels has 0 bytes"),
        (IMAGE, encode(IMAGE, encoding="mono8", height=0, width=0, step=0), "0 × 0 pixels"),
        (IMAGE, b"short", "not sensor_msgs/msg/Image"),
        (
            COMPRESSED,
            encode(COMPRESSED, format="h264", data=np.ones(9, np.uint8)),
            "neither a JPEG nor a PNG",
        ),
        (COMPRESSED, encode(COMPRESSED, format="jpeg"), "neither a JPEG nor a PNG"),
        (COMPRESSED, encode(COMPRESSED, format="png", data=too_large()), "does not read"),
    ],
)
def test_message_that_is_no_picture_says_why(ros_type, data, words):
    with pytest.raises(ValueError, match=words):
        read_image(ros_type, data, 0)


def test_camera_of_ros_has_its_intrinsics_and_its_mount_by_the_frames_up_to_the_base():
    found = camera_file_of(INFO, [MAST, LENS])
    assert found.intrinsics == PICTURE
    assert found.mount.model_dump() == pytest.approx(CAMERA.mount.model_dump())


@pytest.mark.parametrize(
    ("topic", "rectified"),
    [
        ("camera/image_rect", True),
        ("image_rect_color/compressed", True),
        ("camera/rect/image", True),
        ("image_raw", False),
        ("direct/rectangle/image", False),
    ],
)
def test_name_of_a_topic_tells_whether_its_images_are_rectified(topic, rectified):
    assert is_rectified(topic) is rectified


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


@pytest.mark.parametrize(
    ("statics", "words"),
    [
        ([LENS], "no transforms from 'base_link' to 'camera_optical', only mast → camera_optical"),
        ([], "only none"),
        (
            [transform("mast", "camera_optical", (0, 0, 0)), transform("camera_optical", "mast", (0, 0, 0))],
            "only mast → camera_optical, camera_optical → mast",
        ),
    ],
)
def test_frames_that_do_not_reach_the_base_are_named(statics, words):
    with pytest.raises(FormatError, match=words):
        camera_file_of(INFO, statics)


@pytest.mark.parametrize(
    ("x", "error", "words"),
    [
        (math.nan, FormatError, "to 'mast' is not finite"),
        (1e4, ConfigError, r"tf_static: \$.mount.x"),
    ],
)
def test_camera_at_no_place_is_refused(x, error, words):
    with pytest.raises(error, match=words):
        camera_file_of(INFO, [transform("base_link", "mast", (x, 0, 0)), LENS])


@pytest.mark.parametrize(
    ("source", "key"),
    [
        ("ros2/tcp/robot", "image_raw"),
        ("ros2/tcp/robot:7447#image=/camera/image&namespace=bot/", "bot/camera/image"),
        ("ros2/tcp/robot#rmw=zenoh&domain=7&namespace=bot", "7/bot/image_raw/*/*"),
    ],
)
def test_source_names_router_and_key(source, key):
    where = RosSource.parse(source, "image", "image_raw")
    assert (where.endpoint, where.key(where.topic)) == ("tcp/robot:7447", key)


@pytest.mark.parametrize(
    "source",
    [
        "ros2/",
        "ros2/tcp/robot#rmw=dds",
        "ros2/tcp/robot#topic=x",
        "ros2/tcp/r:0",
        "ros2/udp/robot",
        "ros2/tcp/robot#rmw=zenoh&domain=233",
        "ros2/tcp/robot#image=a//b",
    ],
)
def test_source_of_another_form_is_refused(source):
    with pytest.raises(UsageError, match=r"expected ros2/tcp/HOST"):
        RosSource.parse(source, "image", "image_raw")


def test_transforms_give_a_pose_each_time_the_localiser_corrects():
    """As AMCL and a robot publish them: AMCL's is dated ahead."""
    poses = TransformPoses("map")
    odom = Transform("odom", "base_footprint", 1.0, 0.0, 0.0, 0.5)
    with pytest.raises(FormatError, match=r"from 'map' to 'base_footprint', only odom → base_footprint"):
        poses.take(transforms([odom], 5))
    found = read_pose(poses.take(transforms([Transform("map", "/odom", 2.0, 3.0, 0.0, math.pi / 2)], 1005)))
    assert found.pose == pytest.approx((2.0, 4.0, math.pi / 2 + 0.5))
    assert (found.frame, found.stamp_ns, found.covariance.any()) == ("map", 5, False)
    assert poses.take(transforms([odom], 6)) is None
    for turn in ({}, {"z": math.nan, "w": 1.0}):
        link = {"header": {"frame_id": "map"}, "child_frame_id": "odom", "transform": {"rotation": turn}}
        with pytest.raises(FormatError, match="is not a rotation"):
            poses.take(encode(TF, transforms=[link]))
    beyond = {"frame_id": "map", "stamp": {"sec": 1, "nanosec": 1_000_000_000}}
    upright = {"rotation": {"w": 1.0}}
    with pytest.raises(FormatError, match="beyond its seconds"):
        poses.take(
            encode(TF, transforms=[{"header": beyond, "child_frame_id": "odom", "transform": upright}])
        )


@pytest.mark.parametrize("frame", ["base_link", "base_footprint"])
def test_a_frame_of_the_base_has_no_poses(frame):
    with pytest.raises(UsageError, match="that is the base"):
        TransformPoses(frame)


def test_the_footprint_is_the_base_where_base_link_is_not_connected():
    poses = TransformPoses("map")
    links = [
        Transform("chassis", "base_link", 9.0, 9.0, 0.0, 0.0),
        Transform("map", "base_footprint", 2.0, 1.0, 0.0, 0.5),
    ]
    assert read_pose(poses.take(transforms(links, 5))).pose == pytest.approx((2.0, 1.0, 0.5))
