"""A camera of a ROS 2 robot in both Zenoh forms: its pictures, its camera_info and its place on the robot."""

import json
import math

import cv2
import numpy as np
import pytest
from kit.tags import CAMERA, PICTURE, WALL, picture_of
from kit.zenoh_session import open_router, repeating
from scipy.spatial.transform import Rotation

from bridge.ros2.discovery import Convention
from bridge.ros2.ros_node import RosNode
from deploy.tag.locate import OPTICAL
from deploy.tag.relay import TransformPoses
from deploy.tag.ros_camera import CAMERA_INFO, COMPRESSED, IMAGE, mount_of, read_image
from deploy.tag.ros_source import RosSource
from rover_ncp import cli
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.errors import FormatError, UsageError
from rover_ncp.core.geometry import Pose
from rover_ncp.wire.cdr import encode
from rover_ncp.wire.messages import (
    POSE_STAMPED,
    POSE_WITH_COVARIANCE,
    TF,
    Transform,
    pose_stamped,
    pose_with_covariance,
    read_pose,
    transforms,
)

POSE = Pose(0.9, 0.05, 0.1)
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
    ],
)
def test_message_that_is_no_picture_says_why(ros_type, data, words):
    with pytest.raises(ValueError, match=words):
        read_image(ros_type, data, 0)


def test_mount_follows_the_frames_up_to_the_base():
    found, missing = mount_of("/camera_optical", [MAST, LENS])
    assert missing == ""
    assert found.model_dump() == pytest.approx(CAMERA.mount.model_dump())


@pytest.mark.parametrize(
    ("statics", "words"),
    [
        ([LENS], "to the camera's frame 'camera_optical': it ends at 'mast'"),
        ([], "it ends at 'camera_optical'"),
        (
            [transform("mast", "camera_optical", (0, 0, 0)), transform("camera_optical", "mast", (0, 0, 0))],
            "ends at",
        ),
    ],
)
def test_frames_that_do_not_reach_the_base_are_named(statics, words):
    found, missing = mount_of("camera_optical", statics)
    assert found is None
    assert words in missing


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
    ],
)
def test_source_of_another_form_is_refused(source):
    with pytest.raises(UsageError, match=r"expected ros2/tcp/HOST"):
        RosSource.parse(source, "image", "image_raw")


def test_transforms_give_a_pose_each_time_the_localiser_corrects():
    """As AMCL and a robot publish them: AMCL's is dated ahead."""
    poses = TransformPoses("map")
    odom = Transform("odom", "base_footprint", 1.0, 0.0, 0.0, 0.5)
    with pytest.raises(FormatError, match=r"from 'map' to 'base_link', only odom → base_footprint"):
        poses.take(transforms([odom], 5))
    found = read_pose(poses.take(transforms([Transform("map", "/odom", 2.0, 3.0, 0.0, math.pi / 2)], 1005)))
    assert found.pose == pytest.approx((2.0, 4.0, math.pi / 2 + 0.5))
    assert (found.frame, found.stamp_ns, found.covariance.any()) == ("map", 5, False)
    assert poses.take(transforms([odom], 6)) is None
    with pytest.raises(FormatError, match="is not a rotation"):
        poses.take(encode(TF, transforms=[{"header": {"frame_id": "map"}, "child_frame_id": "odom"}]))


@pytest.fixture
def publish():
    """Return a function that publishes a robot's topics until the test ends, and the router's address."""
    session, address = open_router()
    latched = []
    with repeating(session, 0.05) as start:

        def publish(convention, topics):
            node = RosNode(session, convention, domain=3)
            for data in (MAST, LENS):
                latched.append(node.publisher("tf_static", TF, latched=True))
                latched[-1].put(data)
            for name, ros_type, data in topics:
                publisher = node.publisher(name, ros_type)
                start(lambda number, put=publisher.put, data=data: put(data[number % len(data)]))
            return address

        yield publish


@pytest.mark.parametrize(
    ("convention", "settings", "ros_type", "message"),
    [
        (Convention.ROS2DDS, "#image=camera/image_raw", IMAGE, image),
        (
            Convention.RMW_ZENOH,
            "#rmw=zenoh&domain=3&image=camera/image_raw/compressed",
            COMPRESSED,
            compressed_image,
        ),
    ],
)
def test_poses_come_from_a_ros_camera_with_its_own_camera_info_and_mount(
    publish, convention, settings, ros_type, message, tmp_path, capsys
):
    pictures = [message(picture_of(POSE, seed=seed)) for seed in range(3)]
    topic = settings.partition("image=")[2]
    topics = [(topic, ros_type, pictures), ("camera/camera_info", CAMERA_INFO, [INFO])]
    source = f"ros2/{publish(convention, topics)}{settings}"
    tags = tmp_path / "tags.yaml"
    tags.write_text(dump_yaml(WALL.model_dump(mode="json")))
    assert cli.run(["tag", "run", "--camera", source, "--map", str(tags), "--seconds", "1", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["poses"] >= 2
    assert math.dist((found["last"]["x"], found["last"]["y"]), POSE[:2]) < 0.01


def test_ros_camera_without_camera_info_says_what_to_give(publish, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("deploy.tag.ros_camera.WAIT_S", 0.3)
    tags = tmp_path / "tags.yaml"
    tags.write_text(dump_yaml(WALL.model_dump(mode="json")))
    source = f"ros2/{publish(Convention.ROS2DDS, [])}"
    assert cli.run(["tag", "run", "--camera", source, "--map", str(tags)]) == 2
    assert (
        "no camera_info on 'camera/camera_info' within 0.3 s; give --camera-file" in capsys.readouterr().err
    )


AMCL = pose_with_covariance(POSE, np.eye(3) * 1e-4, 7, "map")
TRANSFORMS = transforms(
    [
        Transform("map", "odom", 0.0, 0.0, 0.0, 0.0),
        Transform("odom", "base_link", *POSE[:2], 0.0, POSE.theta),
    ],
    7,
)


@pytest.mark.parametrize(
    ("topic", "ros_type", "data", "convention", "settings"),
    [
        ("amcl_pose", POSE_WITH_COVARIANCE, AMCL, Convention.RMW_ZENOH, "#rmw=zenoh&domain=3"),
        ("here", POSE_STAMPED, pose_stamped(POSE, 7, "map"), Convention.ROS2DDS, "#topic=here"),
        ("tf", TF, TRANSFORMS, Convention.ROS2DDS, "#topic=tf"),
    ],
)
def test_poses_of_ros_reach_the_bridge(publish, topic, ros_type, data, convention, settings, capsys):
    source = publish(convention, [(topic, ros_type, [data])])
    bridge, address = open_router()
    with bridge:
        arrived = []
        held = bridge.declare_subscriber("pose", lambda sample: arrived.append(sample.payload.to_bytes()))
        command = [
            "tag",
            "relay",
            "--from",
            f"ros2/{source}{settings}",
            "--robot",
            address,
            "--seconds",
            "0.6",
        ]
        assert cli.run([*command, "--json"]) == 0
        del held
    assert json.loads(capsys.readouterr().out)["poses"] == len(arrived) > 0
    found = read_pose(arrived[0])
    assert found.pose == pytest.approx(POSE)
    assert (found.frame, found.covariance[0, 0]) == ("map", 1e-4 if topic == "amcl_pose" else 0.0)


def test_pose_of_another_frame_is_not_relayed_and_names_both(publish, capsys):
    source = publish(Convention.ROS2DDS, [("amcl_pose", POSE_WITH_COVARIANCE, [AMCL])])
    bridge, address = open_router()
    with bridge:
        command = ["tag", "relay", "--from", f"ros2/{source}", "--robot", address, "--seconds", "0.5"]
        assert cli.run([*command, "--frame", "odom"]) == 1
    assert capsys.readouterr().out.count("pose in frame 'map', expected 'odom'") == 1
