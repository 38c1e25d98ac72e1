"""A recording's messages as arrays, one for each topic with numbers."""

import logging
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import Pose
from rover_ncp.recording.recorded import steady
from rover_ncp.recording.recording import read_recording
from rover_ncp.wire import messages

_log = logging.getLogger(__name__)


def read_arrays(path: str | Path) -> dict[str, NDArray[np.void]]:
    """Return each topic's messages as a structured array, in order: ``arrays["odom"]["x"]`` is (n,).

    The field ``t`` of each is the arrival in s since the recording's first message, also where the wall clock
    was set. Units are SI, potentials mV. Topics without numbers (text, transforms) are left out. So are
    messages that cannot be read or that lack the fields of their topic; a warning in the log counts them.
    Raises FileError for a file that cannot be read.
    """
    recording = read_recording(Path(path))
    rows: dict[str, list[Mapping[str, float]]] = {}
    problems: dict[str, list[str]] = {}
    began_ns: int | None = None
    for message in steady(recording.messages):
        began_ns = message.log_ns if began_ns is None else began_ns
        read = _READERS.get(message.type)
        if read is None:
            continue
        try:
            values = read(message.data)
        except FormatError as error:
            problems.setdefault(message.topic, []).append(str(error))
            continue
        rows.setdefault(message.topic, []).append({"t": (message.log_ns - began_ns) * 1e-9} | dict(values))
    arrays = {}
    for topic, of_topic in rows.items():
        # A peer may send other names of neurons than the driver.
        fields = Counter(map(tuple, of_topic)).most_common(1)[0][0]
        fitting = [tuple(row.values()) for row in of_topic if tuple(row) == fields]
        arrays[topic] = np.array(fitting, dtype=[(name, np.float64) for name in fields])
        other = len(of_topic) - len(fitting)
        problems.setdefault(topic, []).extend([f"the fields are not {', '.join(fields)}"] * other)
    for topic, found in problems.items():
        if found:
            _log.warning("%s: unreadable messages on %s left out: %d, %s", path, topic, len(found), found[0])
    return arrays


def _odometry(data: bytes) -> dict[str, float]:
    sample = messages.read_odometry(data)
    return sample.pose._asdict() | sample.velocity._asdict()


def _pose(data: bytes) -> dict[str, float]:
    sample = messages.read_pose(data)
    deviations = np.sqrt(np.maximum(np.diag(sample.covariance), 0.0))
    return sample.pose._asdict() | dict(
        zip((f"std_{name}" for name in Pose._fields), deviations, strict=True)
    )


_READERS: dict[str, Callable[[bytes], Mapping[str, float]]] = {
    messages.ODOMETRY: _odometry,
    messages.IMU: lambda data: {"rate": messages.read_imu(data).rate},
    messages.TWIST_STAMPED: lambda data: messages.read_twist(data).velocity._asdict(),
    messages.POSE_WITH_COVARIANCE: _pose,
    messages.POSE_STAMPED: lambda data: messages.read_pose_stamped(data)._asdict(),
    messages.FLOATS: messages.read_neurons,
}
