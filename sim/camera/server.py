"""The camera of a mock: a process that renders pictures from the true pose and serves them over HTTP.

Mock and camera share the pose with its moment without a lock, because a killed process would keep it. So a
picture may mix the numbers of two turns of the mock's loop, which are 10 ms apart.
"""

import ctypes
import multiprocessing
import time
from collections import deque
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from multiprocessing.connection import Connection
from multiprocessing.sharedctypes import RawArray
from pathlib import Path
from typing import Any

import cv2

from deploy.tag.tag_map import CameraFile, TagMap
from rover_ncp.core.config import load_yaml
from rover_ncp.core.errors import PortInUse, UsageError
from rover_ncp.core.geometry import ORIGIN, Pose
from rover_ncp.core.process import ClosedAtExit
from rover_ncp.core.spawned import end_with_parent, starting_processes
from rover_ncp.core.streams import Domain, random_stream
from sim.camera.render import Renderer

BOUNDARY = "picture"
START_S = 30.0
"""Longest wait for the process to listen."""
DELAY_S = 0.1
"""Time from the exposure of a picture to its stamp."""
QUALITY = 92
"""Of the JPEGs; with less, the tags' edges move."""


class MockCamera(ClosedAtExit):
    """Starts the camera's process; ``address`` is the stream's. Raises UsageError and FileError."""

    def __init__(self, camera: Path, tags: Path, listen: tuple[str, int], hz: float, seed: int) -> None:
        settings = load_yaml(camera, CameraFile), load_yaml(tags, TagMap)
        self._pose: Any = RawArray(ctypes.c_double, 4)
        """x, y, theta, and the moment in s: on a busy machine, the mock's loop falls behind."""
        self.show(ORIGIN, time.time_ns())
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        arguments = (self._pose, theirs, settings, listen, (hz, seed))
        self._process = context.Process(target=_serve, args=arguments, name="camera", daemon=True)
        with starting_processes():
            self._process.start()
        theirs.close()
        camera_at = f"camera {listen[0]}:{listen[1]}"
        if not ours.poll(START_S):
            self.close()
            raise UsageError(f"{camera_at}: its process did not start within {START_S:g} s; start it again")
        try:
            answer = ours.recv()
        except EOFError as error:
            self._process.join()
            code = self._process.exitcode
            raise UsageError(
                f"{camera_at}: its process ended with exit code {code} before it served a picture"
            ) from error
        if isinstance(answer, str):
            self.close()
            raise PortInUse(f"{camera_at}: {answer}")
        self.address = f"http://{listen[0]}:{answer}/"

    def show(self, pose: Pose, wall_ns: int) -> None:
        """Let the next pictures be of this pose at this moment."""
        self._pose[:] = [*pose, 1e-9 * wall_ns]

    def close(self) -> None:
        """End the process."""
        self._process.terminate()
        self._process.join(2.0)
        if self._process.is_alive():
            self._process.kill()


def _serve(
    pose: Any, ready: Connection, settings: Any, listen: tuple[str, int], rate: tuple[float, int]
) -> None:
    """Run the camera's process."""
    end_with_parent()
    cv2.setNumThreads(1)
    (camera, tag_map), (hz, seed) = settings, rate
    renderer = Renderer(camera, tag_map, random_stream(seed, Domain.PICTURES))

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:  # the library's name
            self.send_response(200)
            self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY}")
            self.end_headers()
            due, waiting = time.monotonic(), deque[tuple[float, float, bytes]]()
            while True:
                now = time.monotonic()
                if now >= due:
                    due = max(due + 1.0 / hz, now)
                    x, y, theta, wall = pose
                    picture = renderer.picture(Pose(x, y, theta))
                    jpeg = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
                    waiting.append((now + DELAY_S, wall + DELAY_S, jpeg[1].tobytes()))
                while waiting and waiting[0][0] <= time.monotonic():
                    _, stamp, data = waiting.popleft()
                    head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n"
                    try:
                        self.wfile.write(f"{head}X-Timestamp: {stamp:.6f}\r\n\r\n".encode() + data + b"\r\n")
                    except OSError:  # the client has gone
                        return
                time.sleep(0.002)

        def log_message(self, format: str, *arguments: Any) -> None:
            pass

    try:
        server = ThreadingHTTPServer(listen, Handler)
    except OSError as error:
        ready.send(error.strerror or str(error))
        return
    server.daemon_threads = True
    ready.send(server.server_address[1])
    server.serve_forever()
