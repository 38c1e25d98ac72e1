"""The measurement path: from received bytes to decoded samples with their time of measurement.

`Measurements` takes the arrivals out of the link's inboxes and decodes each once. `replay` uses the same
functions to decode.
"""

import logging
import zlib
from collections import Counter
from collections.abc import Callable
from typing import Any, Generic, NamedTuple, Self, TypeVar

from deploy.drive.link import Arrival, Link
from rover_ncp.core.clock_offset import StampClock
from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import same_frame
from rover_ncp.wire.messages import (
    COURSE_FRAME,
    OdometrySample,
    PoseSample,
    TurnSample,
    read_imu,
    read_odometry,
    read_pose,
)

_LOGGER = logging.getLogger("rover_ncp")

Sample = OdometrySample | TurnSample | PoseSample
SampleT = TypeVar("SampleT", OdometrySample, TurnSample, PoseSample)


class SampleRef(NamedTuple):
    """Identifies a sample: stamp, CRC-32 of its bytes, time of measurement on the driver's clock, topic."""

    stamp_ns: int
    crc: int
    measured_ns: int
    topic: str = "odom"

    @classmethod
    def of(cls, stamp_ns: int, data: bytes, measured_ns: int, topic: str = "odom") -> Self:
        """Identify a sample."""
        return cls(stamp_ns, zlib.crc32(data), measured_ns, topic)

    def seconds_to(self, moment_ns: int) -> float:
        """Return the time from this sample to a moment of the driver's clock, in s."""
        return (moment_ns - self.measured_ns) * 1e-9


class Measurement(NamedTuple, Generic[SampleT]):
    """A decoded sample. Its values are not checked and may be NaN."""

    sample: SampleT
    ref: SampleRef
    arrival_ns: int


def pose_reader(frame: str | None) -> Callable[[bytes], PoseSample]:
    """Return the decoder of external poses, which raises FormatError for a pose in another frame.

    With None it takes poses in any frame.
    """

    def read(data: bytes) -> PoseSample:
        sample = read_pose(data)
        if frame is not None and not same_frame(sample.frame, frame):
            raise FormatError(f"pose in frame {sample.frame!r}, expected {frame!r}")
        return sample

    return read


def readers(pose_frame: str) -> dict[str, Callable[[bytes], Sample]]:
    """Return the decoder of each topic that is an input of the controller."""
    return {"odom": read_odometry, "imu": read_imu, "pose": pose_reader(pose_frame)}


class Measurements:
    """Takes the received samples of one link, decodes them and counts them by topic."""

    def __init__(self, link: Link, pose_frame: str | None = COURSE_FRAME) -> None:
        self._link, self._read_pose = link, pose_reader(pose_frame)
        # External poses may come late, out of order, and stamped by any clock.
        self._frame, self._named = pose_frame, pose_frame is None
        self._clocks = {"odom": StampClock(), "imu": StampClock(), "pose": StampClock(in_order=False)}
        self._before: dict[str, tuple[Arrival, Any]] = {}
        """The last message of each topic and its sample."""
        self.newest: Measurement[OdometrySample] | None = None
        self.taken: Counter[str] = Counter()
        self.unreadable: Counter[str] = Counter()
        self.complaints = link.complaints
        self.doubtful: Counter[str] = Counter()
        """Samples that are not used because of their stamps."""

    def odometry(self, timeout_s: float) -> Measurement[OdometrySample] | None:
        """Return the newest odometry not yet taken; wait for it at most ``timeout_s``."""
        found = self._read("odom", read_odometry, self._link.odometry.take(timeout_s))
        if not found:
            return None
        self.newest = found[-1]
        return self.newest

    def gyro(self) -> list[Measurement[TurnSample]]:
        """Return the gyro readings since the last call; never waits."""
        return self._read("imu", read_imu, self._link.gyro.take())

    def poses(self) -> list[Measurement[PoseSample]]:
        """Return the external poses since the last call; never waits."""
        found = self._read("pose", self._read_pose, self._link.poses.take())
        if found and not self._named and any(not pose.sample.frame for pose in found):
            self._named = True
            _LOGGER.info(
                f"poses on 'pose' have an empty frame_id: they are taken for poses in {self._frame!r}"
            )
        return found

    def _read(
        self, topic: str, read: Callable[[bytes], SampleT], arrivals: list[Arrival]
    ) -> list[Measurement[SampleT]]:
        if not arrivals:
            return []
        clock, found = self._clocks[topic], list[Measurement[SampleT]]()
        for arrival in arrivals:
            try:
                sample = read(arrival.data)
            except FormatError as error:
                self.complaints.setdefault(topic, str(error))
                if not self.unreadable[topic]:
                    _LOGGER.info(f"a message on '{topic}' is not used: {error}")
                self.unreadable[topic] += 1
                continue
            if sample.stamp_ns == 0:  # a publisher without a clock
                found.append(_measurement(topic, arrival, sample, arrival.arrival_ns))
                continue
            measured_ns = clock.measured_ns(sample.stamp_ns, arrival.arrival_ns)
            if clock.set_back_s:
                _LOGGER.info(f"the clock that stamps '{topic}' was set back by {clock.set_back_s:.2f} s")
            if clock.late_ns is not None:
                found.append(_measurement(topic, *self._before[topic], clock.late_ns))
                self.doubtful[topic] -= 1
            if measured_ns is not None:
                if topic == "imu":  # the bridge stamps it as odometry, with the gyro's age in it
                    same_ns = self._clocks["odom"].receiver_ns(sample.stamp_ns)
                    measured_ns = min(arrival.arrival_ns, measured_ns if same_ns is None else same_ns)
                found.append(_measurement(topic, arrival, sample, measured_ns))
            else:
                self.doubtful[topic] += 1
            self._before[topic] = arrival, sample
        self.taken[topic] += len(found)
        return found


def _measurement(topic: str, arrival: Arrival, sample: SampleT, measured_ns: int) -> Measurement[SampleT]:
    ref = SampleRef.of(sample.stamp_ns, arrival.data, measured_ns, topic)
    return Measurement(sample, ref, arrival.arrival_ns)
