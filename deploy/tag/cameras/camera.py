"""Pictures of a camera that runs, or of a folder."""

import io
import logging
import os
import re
import threading
import time
import warnings
from abc import abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydantic import BaseModel, Field

from deploy.drive.link import Inbox
from rover_ncp.core.clock_offset import StampClock
from rover_ncp.core.errors import FileError, UsageError
from rover_ncp.core.process import ClosedAtExit

_LOGGER = logging.getLogger("rover_ncp")

TIMEOUT_S = 3.0
"""A live camera without a picture that can be read for so long is lost, also at its beginning."""
MAX_PIXELS = 50_000_000
"""Most pixels of a picture; its size is read before the picture is decoded."""
MAX_FILE = 1 << 26
"""Most bytes of a picture's file."""
WORTH, LIMIT = 2, 10
"""A bad stamp counts so much, a good one -1; at the limit, stamps are not used any more."""
PICTURES = frozenset({".png", ".jpg", ".jpeg"})


@dataclass(frozen=True)
class Picture:
    """Grey levels, height × width, and the moment of the exposure in ns since the epoch."""

    grey: NDArray[np.uint8]
    wall_ns: int


class DeviceSettings(NamedTuple):
    """What a device is set to; None is left as it is. ``focus`` is in the driver's units."""

    size: tuple[int, int] | None = None
    rate_hz: float | None = None
    focus: float | None = None


def is_device(source: str) -> bool:
    """Whether a source names a device: a number, a path of ``/dev``, or a link to one."""
    return source.isdecimal() or source.startswith("/dev/") or Path(source).is_char_device()


def folder_pictures(source: str, left_out: Counter[str]) -> Iterator[Picture]:
    """Return the pictures of a folder. Raises FileError.

    Pictures that cannot be read are counted in ``left_out``, by reason.
    """
    path = Path(source)
    if not path.is_dir():
        *login, place = source.rpartition("@")  # it may be an address that holds a password
        raise FileError(
            f"{'...@' * any(login)}{place}: no such folder; expected a device (0 or /dev/video0; 'rover-ncp "
            "tag cameras' lists them), http://HOST:PORT/PATH, or a folder of pictures"
        )
    return _pictures_in(path, left_out)


def _pictures_in(path: Path, left_out: Counter[str]) -> Iterator[Picture]:
    # Copying from a Mac leaves files such as ._p0.jpg, which are no pictures.
    files = [each for each in path.iterdir() if each.suffix.lower() in PICTURES and each.name[0] != "."]
    files = [each for each in files if each.is_file()]
    read, problem = 0, "it has no .png or .jpg"
    for each in sorted(files):
        try:
            with each.open("rb") as file:
                picture = decode_picture(file.read(MAX_FILE), each.stat().st_mtime_ns)
        except (OSError, ValueError) as error:
            problem = getattr(error, "strerror", None) or str(error)
            left_out[problem] += 1
            _LOGGER.warning("%s: left out: %s", each, problem)
            continue
        read += 1
        yield picture
    if not read:
        raise FileError(f"{path}: no picture can be read: {problem}")


def decode_picture(data: bytes, wall_ns: int) -> Picture:
    """Decode a JPEG or PNG. Raises ValueError."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(data), formats=("JPEG", "PNG")) as header:
                width, height = header.size
    except Image.DecompressionBombError:
        width = height = MAX_PIXELS
    except (OSError, SyntaxError, ValueError) as error:  # Pillow raises all of these
        raise ValueError("a picture is neither a JPEG nor a PNG") from error
    if width * height > MAX_PIXELS:
        raise ValueError(f"a picture has more than {MAX_PIXELS} pixels")
    try:
        frame = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    except cv2.error:
        frame = None
    if frame is None:
        raise ValueError("a picture is damaged")
    return Picture(np.asarray(frame, np.uint8), wall_ns)


class PictureMoments:
    """When pictures were taken, by their stamps and arrivals. The stamps may be of any clock."""

    def __init__(self) -> None:
        self._clock = StampClock()
        self._last_ns, self._bad = 0, 0

    def wall_ns(self, stamp_ns: int | None, arrival_ns: int, monotonic_ns: int) -> int | None:
        """Return a picture's moment; None if its stamp cannot be right.

        ``monotonic_ns`` is this machine's monotonic clock minus its wall clock. A picture without a stamp was
        taken when it arrived, as are all of a camera whose stamps are not those of a clock: they repeat, or
        run at another rate.
        """
        if stamp_ns is None or self._bad >= LIMIT:
            return arrival_ns
        again, self._last_ns = stamp_ns == self._last_ns, stamp_ns
        measured_ns = None if again else self._clock.measured_ns(stamp_ns, arrival_ns + monotonic_ns)
        self._bad = self._bad + WORTH if measured_ns is None else max(self._bad - 1, 0)
        if self._bad >= LIMIT:
            return arrival_ns
        return None if measured_ns is None else measured_ns - monotonic_ns


class LiveCamera(ClosedAtExit):
    """The newest picture of a camera that runs: no picture waits in a queue.

    Iterating ends with UsageError when the camera sends no picture that can be read for `TIMEOUT_S`. Pictures
    that cannot be read are counted in ``left_out``, by reason. ``name`` is the camera's in messages.
    """

    def __init__(self, name: str, left_out: Counter[str]) -> None:
        self._name, self._left_out, self._problem = name, left_out, ""
        self._moments = PictureMoments()
        self.newest = Inbox[Callable[[], Picture] | str](2)
        """Functions that decode the newest pictures, or raise ValueError; why the camera ended."""

    def __iter__(self) -> Iterator[Picture]:
        seen_s = time.monotonic()
        while True:
            arrived = self.newest.take(TIMEOUT_S)
            for decode in [each for each in arrived if callable(each)][-1:]:
                try:
                    picture = decode()
                except ValueError as error:
                    self.leave_out(str(error))
                else:
                    self._problem = ""
                    yield picture
                    seen_s = time.monotonic()
            ends = [each for each in arrived if isinstance(each, str)]
            if ends or not arrived or time.monotonic() - seen_s > TIMEOUT_S:
                words = [*ends, self._problem or f"no picture for {TIMEOUT_S:g} s"]
                raise UsageError(f"camera {self._name}: {words[0]}")

    def moment_ns(self, stamp_ns: int | None, arrival_ns: int) -> int | None:
        """Return when a picture was taken, by the wall clock; None if it is left out."""
        found = self._moments.wall_ns(stamp_ns, arrival_ns, time.monotonic_ns() - time.time_ns())
        if found is None:
            self.leave_out("the time of a picture contradicts the times of others")
        return found

    def leave_out(self, reason: str) -> None:
        """Count a picture that is not used; the first one of each reason is a line of the log."""
        if not self._left_out[reason]:
            _LOGGER.warning("camera %s: left out: %s", self._name, reason)
        self._left_out[reason] += 1
        self._problem = reason


class ReadCamera(LiveCamera):
    """A camera that a thread reads, from `start` on."""

    _closing = False

    def start(self) -> None:
        """Start the thread; a subclass is then complete."""
        threading.Thread(target=self._run, name="camera", daemon=True).start()

    def close(self) -> None:
        """End the thread at its next picture."""
        self._closing = True

    def _run(self) -> None:
        try:
            for picture in self._pictures():
                if self._closing:
                    return
                self.newest.put(picture)
            self.newest.put("it sends no more pictures")
        except (OSError, ValueError, ArithmeticError) as error:
            self.newest.put(str(error) or type(error).__name__)

    @abstractmethod
    def _pictures(self) -> Iterator[Callable[[], Picture]]:
        """Yield functions that decode a picture. Raises ValueError or OSError at the camera's end."""


class DeviceCamera(ReadCamera):
    """A camera of this machine: its number, its path, or a link to that such as those of /dev/v4l/by-id."""

    def __init__(self, source: str, settings: DeviceSettings, left_out: Counter[str]) -> None:
        super().__init__(source, left_out)
        self._settings = settings
        self._path = os.path.realpath(f"/dev/video{source}" if source.isdecimal() else source)
        self.start()

    def _pictures(self) -> Iterator[Callable[[], Picture]]:
        number = re.fullmatch(r"/dev/video(\d{1,3})", self._path)  # OpenCV raises for long ones
        capture = cv2.VideoCapture(int(number[1]) if number else self._path, cv2.CAP_V4L2)
        try:
            if not capture.isOpened():
                raise ValueError(self._closed())
            self._set(capture)
            while True:
                more, frame = capture.read()
                read_ns = time.time_ns()
                if not more:
                    return
                grey = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) if frame.ndim == 3 else frame
                yield partial(Picture, np.asarray(grey, np.uint8), read_ns)
        finally:
            capture.release()

    def _set(self, capture: cv2.VideoCapture) -> None:
        size, rate_hz, focus = self._settings
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        if size is not None:
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])
        if rate_hz is not None:
            capture.set(cv2.CAP_PROP_FPS, rate_hz)
        if focus is not None:
            capture.set(cv2.CAP_PROP_AUTOFOCUS, 0)
            if not capture.set(cv2.CAP_PROP_FOCUS, focus):
                _LOGGER.warning("camera %s: focus %g: the camera does not take it", self._name, focus)
        elif capture.get(cv2.CAP_PROP_AUTOFOCUS) > 0:
            _LOGGER.warning(
                "camera %s: its autofocus is on, and the calibration changes with the focus: write 'focus: "
                "NUMBER' into the camera's file, and calibrate with it",
                self._name,
            )

    def _closed(self) -> str:
        """Return why the device does not open."""
        if not Path(self._path).exists():
            there = ", ".join(each.path for each in devices()) or "none"
            return f"there is no {self._path}; cameras of this machine: {there}"
        if not os.access(self._path, os.R_OK | os.W_OK):
            return f"{self._path}: permission denied; add your user to the group video and log in again"
        return (
            f"{self._path} gives no pictures, or another program uses it; 'rover-ncp tag cameras' lists all"
        )


class Device(BaseModel):
    """A camera of this machine."""

    path: str = Field(description="for --camera")
    name: str = Field(description="as the camera calls itself")
    stable: str = Field(description="a path that it keeps when other cameras are plugged in; empty for none")


def devices(root: Path = Path("/")) -> list[Device]:
    """Return the cameras of this machine (Linux)."""
    links = {link.resolve().name: link for link in sorted((root / "dev/v4l/by-id").glob("*"))}
    nodes = [node for node in (root / "sys/class/video4linux").glob("video*") if node.name[5:].isdecimal()]
    found = []
    for node in sorted(nodes, key=lambda each: int(each.name[5:])):
        try:
            name, index = ((node / each).read_text().strip() for each in ("name", "index"))
        except OSError:  # unplugged at this moment
            continue
        if index == "0":  # the others of a camera carry no pictures
            stable = f"/{links[node.name].relative_to(root)}" if node.name in links else ""
            found.append(Device(path=f"/dev/{node.name}", name=name, stable=stable))
    return found
