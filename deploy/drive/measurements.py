"""The measurement path: from received bytes to decoded samples with the moment of their measurement.

The link stores arrivals in an `Inbox` for each kind: odometry (only the newest), gyro, external poses.
`Measurements` takes them out and decodes each once. `replay` uses the same functions to decode.
"""

import threading
import zlib
from collections import Counter, deque
from collections.abc import Callable
from typing import Generic, NamedTuple, Protocol, Self, TypeVar

from rover_ncp.core.errors import FormatError
from rover_ncp.core.messages import (
    COURSE_FRAME,
    OdometrySample,
    PoseSample,
    TurnSample,
    read_imu,
    read_odometry,
    read_pose,
)

NS = 1_000_000_000
"""Nanoseconds in a second."""
INBOX_LENGTH = 1000
STAMP_WINDOW_NS = 60 * NS

Sample = OdometrySample | TurnSample | PoseSample
SampleT = TypeVar("SampleT", OdometrySample, TurnSample, PoseSample)


class Arrival(NamedTuple):
    """A message and the moment of its arrival on the monotonic clock."""

    data: bytes
    arrival_ns: int


class Inbox:
    """Keeps the newest ``length`` arrivals until they are taken, and wakes the thread that waits for one.

    Zenoh's own ring channel cannot be waited for with a limit.
    """

    def __init__(self, length: int = INBOX_LENGTH) -> None:
        self._changed = threading.Condition()
        self._arrivals: deque[Arrival] = deque(maxlen=length)

    def put(self, arrival: Arrival) -> None:
        """Add an arrival; from any thread."""
        with self._changed:
            self._arrivals.append(arrival)
            self._changed.notify()

    def take(self, timeout_s: float = 0.0) -> list[Arrival]:
        """Return and remove all arrivals, in order; wait for the first at most ``timeout_s``."""
        with self._changed:
            if not self._arrivals and timeout_s > 0:
                self._changed.wait(timeout_s)
            arrivals = list(self._arrivals)
            self._arrivals.clear()
            return arrivals


class MeasurementSource(Protocol):
    """The received messages of a link."""

    @property
    def odometry(self) -> Inbox:
        """The newest odometry of the base; the inbox has the length 1."""

    @property
    def gyro(self) -> Inbox:
        """Readings of the base's gyro."""

    @property
    def poses(self) -> Inbox:
        """External poses, in the course's frame."""


class StampClock:
    """The moment of a measurement on the receiver's clock, from the sender's stamp and the arrival.

    Arrival minus stamp is an unknown constant plus the transit time. Its minimum over the last minute stands
    for the constant and the shortest transit; the excess of a sample is its age. All times are in ns.
    """

    def __init__(self, in_order: bool = True) -> None:
        self._in_order = in_order
        self._smallest: deque[tuple[int, int]] = deque()  # (arrival, arrival − stamp), both rising
        self._measured_ns: int | None = None

    def measured_ns(self, stamp_ns: int, arrival_ns: int) -> int:
        """Return when the sample was measured; for samples in order never before the previous one."""
        offset = arrival_ns - stamp_ns
        while self._smallest and self._smallest[-1][1] >= offset:
            self._smallest.pop()
        self._smallest.append((arrival_ns, offset))
        while self._smallest[0][0] < arrival_ns - STAMP_WINDOW_NS:
            self._smallest.popleft()
        measured = stamp_ns + self._smallest[0][1]
        if self._in_order and self._measured_ns is not None:
            measured = max(measured, self._measured_ns)
        self._measured_ns = measured
        return measured


class SampleRef(NamedTuple):
    """Names a sample: stamp, CRC-32 of its bytes, time of measurement on the driver's clock, topic."""

    stamp_ns: int
    crc: int
    measured_ns: int
    topic: str = "odom"

    @classmethod
    def of(cls, stamp_ns: int, data: bytes, measured_ns: int, topic: str = "odom") -> Self:
        """Name a sample."""
        return cls(stamp_ns, zlib.crc32(data), measured_ns, topic)

    def seconds_to(self, moment_ns: int) -> float:
        """Return the time from this sample to a moment of the driver's clock, in s."""
        return (moment_ns - self.measured_ns) * 1e-9


class Measurement(NamedTuple, Generic[SampleT]):
    """A decoded sample. Its values are not checked and may be NaN."""

    sample: SampleT
    ref: SampleRef
    arrival_ns: int


def read_course_pose(data: bytes) -> PoseSample:
    """Read an external pose. Raises FormatError, also for a pose in another frame than the course's."""
    sample = read_pose(data)
    if sample.frame not in {"", COURSE_FRAME}:
        raise FormatError(f"pose in frame {sample.frame!r}, expected {COURSE_FRAME!r}")
    return sample


READERS: dict[str, Callable[[bytes], Sample]] = {
    "odom": read_odometry,
    "imu": read_imu,
    "pose": read_course_pose,
}
"""Decoder of each topic that is an input of the controller."""


class Measurements:
    """Takes the received samples of one link, decodes them and counts them by topic."""

    def __init__(self, source: MeasurementSource) -> None:
        self._source = source
        # External poses may come late, out of order, and stamped by any clock.
        self._clocks = {"odom": StampClock(), "imu": StampClock(), "pose": StampClock(in_order=False)}
        self.newest: Measurement[OdometrySample] | None = None
        """The newest odometry."""
        self.taken: Counter[str] = Counter()
        self.unreadable: Counter[str] = Counter()

    def odometry(self, timeout_s: float) -> Measurement[OdometrySample] | None:
        """Return the newest odometry not yet taken; wait for it at most ``timeout_s``."""
        found = self._read("odom", read_odometry, self._source.odometry.take(timeout_s))
        if not found:
            return None
        self.newest = found[-1]
        return self.newest

    def gyro(self) -> list[Measurement[TurnSample]]:
        """Return the gyro readings since the last call; never waits."""
        return self._read("imu", read_imu, self._source.gyro.take())

    def poses(self) -> list[Measurement[PoseSample]]:
        """Return the external poses since the last call; never waits."""
        return self._read("pose", read_course_pose, self._source.poses.take())

    def _read(
        self, topic: str, read: Callable[[bytes], SampleT], arrivals: list[Arrival]
    ) -> list[Measurement[SampleT]]:
        found = []
        for data, arrival_ns in arrivals:
            try:
                sample = read(data)
            except FormatError:
                self.unreadable[topic] += 1
                continue
            measured_ns = self._clocks[topic].measured_ns(sample.stamp_ns, arrival_ns)
            ref = SampleRef.of(sample.stamp_ns, data, measured_ns, topic)
            found.append(Measurement(sample, ref, arrival_ns))
        self.taken[topic] += len(found)
        return found
