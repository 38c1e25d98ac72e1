"""Pictures of a camera: a device, a video, a folder of pictures, or an MJPEG stream over HTTP."""

import http.client
import logging
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO

import cv2
import numpy as np
from numpy.typing import NDArray

from deploy.drive.link import Inbox
from rover_ncp.core.errors import FileError, UsageError
from rover_ncp.core.process import ClosedAtExit

_LOGGER = logging.getLogger("rover_ncp")

TIMEOUT_S = 3.0
"""A stream without a picture that can be read for so long is lost, also at its beginning."""
MAX_JPEG = 8 << 20
"""Most bytes of a picture in a stream."""
STAMP = "x-timestamp"
"""Header of a picture in a stream: s since the epoch at its exposure or later, as mjpg-streamer sends it."""


@dataclass(frozen=True)
class Picture:
    """Grey levels, height × width, and the moment of the exposure in ns since the epoch."""

    grey: NDArray[np.uint8]
    wall_ns: int


def pictures_of(source: str, delay_s: float = 0.0) -> "LiveCamera | Iterator[Picture]":
    """Return the pictures of a source: a device's number, an http:// address, a file or a folder.

    ``delay_s`` is the time from exposure to a live picture's stamp, or to its arrival if it has none.
    Raises UsageError and FileError.
    """
    if source.isdigit() or source.startswith("http://"):
        return ReadCamera(source, delay_s)
    path = Path(source)
    if path.is_dir():
        return _folder(path)
    if not path.is_file():
        raise FileError(f"{source}: no such file; expected a device's number, a file or http://HOST:PORT/")
    return _video(path)


def _folder(path: Path) -> Iterator[Picture]:
    files = sorted(each for each in path.iterdir() if each.suffix.lower() in {".png", ".jpg", ".jpeg"})
    if not files:
        raise FileError(f"{path}: no pictures (.png, .jpg)")
    for each in files:
        picture = cv2.imread(str(each), cv2.IMREAD_GRAYSCALE)
        if picture is None:
            raise FileError(f"{each}: not a picture")
        yield Picture(np.asarray(picture, np.uint8), each.stat().st_mtime_ns)


def _video(path: Path) -> Iterator[Picture]:
    capture = cv2.VideoCapture(str(path))
    if not capture.isOpened():
        raise FileError(f"{path}: not a video that OpenCV reads")
    began_ns = path.stat().st_mtime_ns
    for grey, _ in _read(capture):
        yield Picture(grey, began_ns + round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6))


def _read(capture: cv2.VideoCapture) -> Iterator[tuple[NDArray[np.uint8], int]]:
    """Yield the grey levels of all pictures, and when each was read (ns)."""
    while True:
        more, frame = capture.read()
        read_ns = time.time_ns()
        if not more:
            return
        grey = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) if frame.ndim == 3 else frame
        yield np.asarray(grey, np.uint8), read_ns


class Ended(str):
    """Why a camera ended; it does not take the place of the last picture."""

    __slots__ = ()


class LiveCamera(ClosedAtExit):
    """The newest picture of a camera that runs: no picture waits in a queue.

    Iterating ends with UsageError when the camera sends no picture that can be read for `TIMEOUT_S`.
    """

    def __init__(self, source: str) -> None:
        self._source = source
        self.newest = Inbox[Callable[[], Picture] | Ended](2)
        """Functions that decode the newest pictures, or raise ValueError, and an end."""

    def __iter__(self) -> Iterator[Picture]:
        seen_s, damaged = time.monotonic(), False
        while True:
            arrived = self.newest.take(TIMEOUT_S)
            pictures = [each for each in arrived if not isinstance(each, Ended)]
            ends = [each for each in arrived if isinstance(each, Ended)]
            if not arrived:
                ends = [Ended(f"no picture for {TIMEOUT_S:g} s")]
            for decode in pictures[-1:]:
                try:
                    picture = decode()
                except ValueError as error:
                    if time.monotonic() - seen_s > TIMEOUT_S:
                        raise UsageError(f"camera {self._source}: {error}") from error
                    if not damaged:
                        _LOGGER.warning("camera %s: left out: %s", self._source, error)
                    damaged = True
                    continue
                seen_s = time.monotonic()
                yield picture
            if ends:
                raise UsageError(f"camera {self._source}: {ends[0]}")


class ReadCamera(LiveCamera):
    """A camera that a thread reads."""

    def __init__(self, source: str, delay_s: float) -> None:
        super().__init__(source)
        self._delay_ns = round(delay_s * 1e9)
        self._closing = False
        threading.Thread(target=self._run, name="camera", daemon=True).start()

    def close(self) -> None:
        """End the thread at its next picture."""
        self._closing = True

    def _run(self) -> None:
        try:
            for picture in self._stream() if self._source.startswith("http://") else self._device():
                if self._closing:
                    return
                self.newest.put(picture)
            why = "it sends no more pictures"
        except (OSError, ValueError, ArithmeticError, http.client.HTTPException) as error:
            why = str(error) or type(error).__name__
        self.newest.put(Ended(why))

    def _device(self) -> Iterator[Callable[[], Picture]]:
        capture = cv2.VideoCapture(int(self._source))
        if not capture.isOpened():
            raise ValueError("no such camera, or another program uses it")
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        for grey, read_ns in _read(capture):
            yield partial(Picture, grey, read_ns - self._delay_ns)

    def _stream(self) -> Iterator[Callable[[], Picture]]:
        with urllib.request.urlopen(self._source, timeout=TIMEOUT_S) as stream:
            boundary = stream.headers.get_param("boundary")
            if not boundary:
                raise ValueError("not an MJPEG stream")
            while (part := _part(stream)) is not None:
                headers, data = part
                wall_ns = round(float(headers[STAMP]) * 1e9) if STAMP in headers else time.time_ns()
                yield partial(compressed, np.frombuffer(data, np.uint8), wall_ns - self._delay_ns)


def compressed(data: NDArray[np.uint8], wall_ns: int) -> Picture:
    """Decode a JPEG or PNG. Raises ValueError."""
    try:
        frame = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if len(data) else None
    except cv2.error as error:  # it says that it is too large
        raise ValueError(f"a picture that OpenCV does not read: {error.err}") from error
    if frame is None:
        raise ValueError("a picture is neither a JPEG nor a PNG")
    return Picture(np.asarray(frame, np.uint8), wall_ns)


def _part(stream: IO[bytes]) -> tuple[dict[str, str], bytes] | None:
    """Return the headers and the content of the next part of a stream; None at its end."""
    headers: dict[str, str] = {}
    while line := stream.readline(4096):
        text = line.decode("latin-1").strip()
        name, colon, value = text.partition(":")
        if colon:
            headers[name.strip().lower()] = value.strip()
        elif not text and "content-length" in headers:
            length = int(headers["content-length"])
            if not 0 < length <= MAX_JPEG:
                raise ValueError(f"a picture of {length} bytes")
            data = stream.read(length)
            return (headers, data) if len(data) == length else None
    return None
