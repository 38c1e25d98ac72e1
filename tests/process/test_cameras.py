"""Cameras over sockets: an MJPEG stream, a ROS 2 robot's in both Zenoh forms; poses of ROS for the bridge."""

import http.server
import itertools
import math
import socket
import struct
import threading
import time

import cv2
import numpy as np
import pytest
from kit.tags import INFO, LENS, MAST, WALL, compressed_image, image, picture_of
from kit.zenoh_session import open_router, repeating

from bridge.ros2.discovery import Convention
from bridge.ros2.ros_node import RosNode
from deploy.tag.camera import pictures_of
from deploy.tag.ros_camera import CAMERA_INFO, COMPRESSED, IMAGE, RosCamera
from rover_ncp import cli
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.errors import UsageError
from rover_ncp.core.geometry import Pose
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
PICTURES = [picture_of(POSE, seed=seed) for seed in range(3)]


class Stream:
    """An MJPEG server with ``parts``, of which each is bytes to send or seconds to wait."""

    def __init__(self, parts):
        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self):
                self.send_response(200)
                self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=b")
                self.end_headers()
                for part in parts:
                    if isinstance(part, bytes):
                        self.wfile.write(part)
                    else:
                        time.sleep(part)

            def log_message(self, *arguments):
                pass

        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        self.address = f"http://127.0.0.1:{self._server.server_address[1]}/"

    def close(self):
        self._server.shutdown()
        self._server.server_close()


def part(level, stamp=None):
    data = cv2.imencode(".jpg", np.full((48, 64), level, np.uint8))[1].tobytes()
    header = f"--b\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n"
    header += f"X-Timestamp: {stamp}\r\n" if stamp else ""
    return f"{header}\r\n".encode() + data + b"\r\n"


DAMAGED = b"--b\r\nContent-Length: 4\r\n\r\nabcd"


@pytest.fixture
def stream():
    servers = []

    def serve(*parts):
        servers.append(Stream(parts))
        return pictures_of(servers[-1].address, delay_s=0.25)

    yield serve
    for server in servers:
        server.close()


def test_stream_gives_the_newest_picture_with_its_moment(stream):
    with stream(part(50, "12.5"), 0.4, part(90), 1.0) as camera:
        pictures = iter(camera)
        first, second = next(pictures), next(pictures)
    assert (first.wall_ns, int(first.grey[0, 0])) == (12_250_000_000, 50)
    assert int(second.grey[0, 0]) == 90
    assert 0.2e9 < time.time_ns() - second.wall_ns < 5e9


def test_damaged_picture_is_left_out(stream, caplog):
    with stream(part(50), 0.2, DAMAGED, 0.2, DAMAGED, 0.2, part(90), 0.2) as camera:
        levels = [int(each.grey[0, 0]) for each in itertools.islice(iter(camera), 2)]
    assert levels == [50, 90]
    assert caplog.text.count("left out: a picture is neither a JPEG nor a PNG") == 1


def test_server_that_does_not_speak_http_ends_the_command_with_its_words():
    with socket.create_server(("127.0.0.1", 0)) as server:
        camera = pictures_of(f"http://127.0.0.1:{server.getsockname()[1]}/")
        with camera, pytest.raises(UsageError, match="hello"):
            accepted, _ = server.accept()
            with accepted:
                accepted.sendall(b"hello\r\n\r\n")
            next(iter(camera))


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ((part(50),), "sends no more pictures"),
        ((part(50), *[DAMAGED, 0.4] * 10), "neither a JPEG nor a PNG"),
        ((part(50), part(90, "inf")), "infinity"),
        ((part(50), b"--b\r\nContent-Length: 99999999999\r\n\r\n"), "a picture of 99999999999 bytes"),
        ((part(50), 3.5), "no picture for 3 s|timed out"),
    ],
)
def test_camera_that_dies_ends_the_command_with_one_line(stream, parts, words):
    with stream(*parts) as camera, pytest.raises(UsageError, match=words):
        list(itertools.islice(iter(camera), 10))


def stamped(data):
    """Return a message that begins with a header, stamped now."""
    now_ns = time.time_ns()
    return data[:4] + struct.pack("<iI", now_ns // 10**9, now_ns % 10**9) + data[12:]


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
                now = stamped if ros_type in {IMAGE, COMPRESSED} else bytes
                start(
                    lambda number, put=publisher.put, data=data, now=now: put(now(data[number % len(data)]))
                )
            return address

        yield publish


@pytest.fixture
def tags(tmp_path):
    """The file of the tags."""
    file = tmp_path / "tags.yaml"
    file.write_text(dump_yaml(WALL.model_dump(mode="json")))
    return file


RAW, COMPRESSED_TOPIC = "camera/image_raw", "camera/image_raw/compressed"


@pytest.mark.parametrize(
    ("convention", "settings", "topic", "ros_type", "message"),
    [
        (Convention.ROS2DDS, "", RAW, IMAGE, image),
        (Convention.RMW_ZENOH, "rmw=zenoh&domain=3&", COMPRESSED_TOPIC, COMPRESSED, compressed_image),
    ],
)
def test_poses_come_from_a_ros_camera_with_its_own_camera_info_and_mount(
    publish, convention, settings, topic, ros_type, message, tags, run_json
):
    topics = [(topic, ros_type, [*map(message, PICTURES)]), ("camera/camera_info", CAMERA_INFO, [INFO])]
    source = f"ros2/{publish(convention, topics)}#{settings}image={topic}"
    code, found = run_json(f"tag run --camera {source} --map {tags} --seconds 1")
    assert code == 0
    assert found["poses"] >= 2
    assert math.dist((found["last"]["x"], found["last"]["y"]), POSE[:2]) < 0.01


def test_picture_of_ros_is_as_much_older_than_its_stamp_as_its_file_says(publish):
    source = f"ros2/{publish(Convention.ROS2DDS, [(RAW, IMAGE, [*map(image, PICTURES)])])}"
    with RosCamera(source, 0.0) as stamped_right, RosCamera(source, 2.0) as stamped_late:
        ages_s = [(time.time_ns() - next(iter(each)).wall_ns) / 1e9 for each in (stamped_right, stamped_late)]
    assert 1.0 < ages_s[1] - ages_s[0] < 3.0


def test_ros_camera_without_camera_info_says_what_to_give(publish, tags, run_json, monkeypatch):
    monkeypatch.setattr("deploy.tag.ros_camera.WAIT_S", 0.3)
    code, found = run_json(f"tag run --camera ros2/{publish(Convention.ROS2DDS, [])} --map {tags}")
    assert code == 2
    assert "no camera_info on 'camera/camera_info' within 0.3 s; give --camera-file" in found["error"]


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
def test_poses_of_ros_reach_the_bridge(publish, topic, ros_type, data, convention, settings, run_json):
    source = publish(convention, [(topic, ros_type, [data])])
    bridge, address = open_router()
    with bridge:
        arrived = []
        held = bridge.declare_subscriber("pose", lambda sample: arrived.append(sample.payload.to_bytes()))
        code, found = run_json(f"tag relay --from ros2/{source}{settings} --robot {address} --seconds 0.6")
        del held
    assert code == 0
    assert found["poses"] == len(arrived) > 0
    found = read_pose(arrived[0])
    assert found.pose == pytest.approx(POSE)
    assert (found.frame, found.covariance[0, 0]) == ("map", 1e-4 if topic == "amcl_pose" else 0.0)


def test_pose_of_another_frame_is_not_relayed_and_names_both(publish, capsys):
    source = publish(Convention.ROS2DDS, [("amcl_pose", POSE_WITH_COVARIANCE, [AMCL])])
    bridge, address = open_router()
    with bridge:
        command = f"tag relay --from ros2/{source} --robot {address} --seconds 0.5 --frame odom"
        assert cli.run(command.split()) == 1
    assert capsys.readouterr().out.count("pose in frame 'map', expected 'odom'") == 1
