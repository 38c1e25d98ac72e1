"""Cameras over sockets: HTTP, and a ROS 2 robot's in both Zenoh forms."""

import base64
import http.server
import math
import struct
import threading
import time
import urllib.parse
import urllib.request
from collections import Counter
from contextlib import contextmanager

import cv2
import numpy as np
import pytest
from kit.tags import INFO, LENS, MAST, WALL, compressed_image, image, picture_of
from kit.zenoh_session import open_router, repeating

from bridge.ros2.discovery import Convention
from bridge.ros2.ros_node import RosNode
from deploy.tag.cameras.http_camera import HttpCamera
from deploy.tag.cameras.ros_camera import CAMERA_INFO, COMPRESSED, IMAGE
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.errors import UsageError
from rover_ncp.core.geometry import Pose
from rover_ncp.wire.messages import TF

POSE = Pose(0.9, 0.05, 0.1)
PICTURES = [picture_of(POSE, seed=seed) for seed in range(3)]


@contextmanager
def serving(answer):
    """A camera over HTTP; yield its host and port. ``answer`` gets the request and writes the answer."""

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            answer(self)

        def log_message(self, *arguments):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"127.0.0.1:{server.server_address[1]}"
        server.shutdown()


def stream_of(*parts):
    """Answer with a stream of ``parts``: each is bytes to send, seconds to wait or an event to wait for."""

    def answer(request):
        request.send_response(200)
        request.send_header("Content-Type", "multipart/x-mixed-replace; boundary=b")
        request.end_headers()
        for part in parts:
            if isinstance(part, bytes):
                request.wfile.write(part)
            elif isinstance(part, threading.Event):
                part.wait(10.0)
            else:
                time.sleep(part)

    return answer


def jpeg(level):
    return cv2.imencode(".jpg", np.full((48, 64), level, np.uint8))[1].tobytes()


def part(level, stamp=None):
    data = jpeg(level)
    header = f"--b\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n"
    header += f"X-Timestamp: {stamp}\r\n" if stamp else ""
    return f"{header}\r\n".encode() + data + b"\r\n"


def level_of(address):
    """Return the grey level of the camera's first picture."""
    with HttpCamera(address, Counter()) as camera:
        return int(next(iter(camera)).grey[0, 0])


def test_stream_gives_the_newest_picture_with_its_moment(monkeypatch):
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")  # a camera is not read through a proxy
    taken, ended = threading.Event(), threading.Event()
    later = part(90, "12.9"), part(200, "13.0")
    answer = stream_of(part(50, "12.5"), taken, 0.5, *later, ended)
    with serving(answer) as host, HttpCamera(f"http://{host}/", Counter()) as camera:
        pictures = iter(camera)
        first = next(pictures)
        taken.set()
        time.sleep(1.0)  # until both later pictures have come, also on a busy machine
        second = next(pictures)
        ended.set()
    assert [int(each.grey[0, 0]) for each in (first, second)] == [50, 200]
    assert 0.0 <= time.time_ns() - second.wall_ns < 1e9
    assert second.wall_ns - first.wall_ns == pytest.approx(0.5e9, abs=0.15e9)


SECRET = "p@ss:w%2Frd"


def protected(request):
    """Answer with a stream if name and password are right."""
    login = base64.b64encode(f"robot:{urllib.parse.unquote(SECRET)}".encode()).decode()
    if request.headers.get("Authorization", "") == f"Basic {login}":
        stream_of(part(50), 0.5)(request)
    else:
        request.send_response(401)
        request.send_header("WWW-Authenticate", 'Basic realm="cam"')
        request.end_headers()


def test_password_of_the_address_is_used_and_in_no_message(caplog):
    with serving(protected) as host:
        assert level_of(f"http://robot:{SECRET}@{host}/s?user=robot") == 50
        for login, words in (("", "asks for a password"), ("robot:wr0ng@", "refuses this name and password")):
            with pytest.raises(UsageError, match=words) as caught:
                level_of(f"http://{login}{host}/s?pwd=wr0ng")
            assert "wr0ng" not in f"{caught.value}{caplog.text}"


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
