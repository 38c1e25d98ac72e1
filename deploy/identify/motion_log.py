"""The motion record of a drive as arrays: commands that reached the base, odometry, external poses.

All times are of the bridge's clock, which stamps odometry and the commands that the gate accepted
(``rover/cmd_out``). External poses have the time of their arrival, less the smallest difference between
arrival and stamp of the odometry around them: that of the clocks and the shortest transit.
"""

import logging
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from rover_ncp.core.console import printable
from rover_ncp.core.errors import FileError, FormatError
from rover_ncp.core.geometry import Pose
from rover_ncp.recording.recording import Recorded
from rover_ncp.robot.description import RobotDescription
from rover_ncp.robot.lasting_error import UNDECLARED, LastingError
from rover_ncp.wire.messages import read_odometry, read_pose, read_twist

FloatArray = NDArray[np.float64]

_log = logging.getLogger("rover_ncp")
_MIN_SAMPLES = 50
"""Minimum number of odometry samples for a fit."""
_NEAR = 20
"""Odometry samples before and after a message that show the difference of the clocks there."""
_LAG = 40
"""Number of reports over which the cycle is first estimated."""


class Track(NamedTuple):
    """Poses over time: t (n,) in s, x and y in m and theta in rad (n, 3), headings not wrapped."""

    t: FloatArray
    poses: FloatArray

    def between(self, begin_s: float, end_s: float) -> FloatArray:
        """Return the poses of an interval, both ends included."""
        return self.poses[(self.t >= begin_s) & (self.t <= end_s)]


class MotionLog(NamedTuple):
    """Times in s from the first odometry."""

    sent_s: FloatArray
    """(m,) when a command went to the base; it holds until the next."""
    sent: FloatArray
    """(m, 2) v in m/s, omega in rad/s."""
    odometry: Track
    motion: FloatArray
    """(n, 2) v and omega as odometry reports them with each pose, or from its poses."""
    external: Track
    """Poses from outside in any one frame, by their arrival on the bridge's clock; may be empty."""
    lasting: LastingError
    """Of the poses from outside."""


class _Arrived(NamedTuple):
    """An external pose, after so many samples of odometry and at this moment of the driver's clock (ns)."""

    seen: tuple[int, int]
    pose: Pose


def motion_log(
    messages: Iterable[Recorded],
    robot: RobotDescription | None = None,
    lasting: Callable[[str], LastingError] = lambda frame: UNDECLARED,
) -> MotionLog:
    """Read a drive's messages; skip malformed ones. Raises FileError when there are too few.

    Of external poses in several frames, those in the most frequent one are used; the log warns of others.
    ``lasting`` returns the lasting error of the poses in a frame.
    Where a robot reports mean speeds, those of the moment are from its poses.
    """
    sent, odometry = list[tuple[float, ...]](), list[tuple[float, ...]]()
    offsets_ns, poses = list[int](), dict[str, list[_Arrived]]()
    for message in messages:
        try:
            if message.topic == "rover/cmd_out":
                twist = read_twist(message.data)
                if twist.stamp_ns is not None:  # the bridge stamps them all
                    sent.append((twist.stamp_ns, *twist.velocity))
            elif message.topic == "odom":
                sample = read_odometry(message.data)
                odometry.append((sample.stamp_ns, *sample.pose, *sample.velocity))
                offsets_ns.append(message.log_ns - sample.stamp_ns)
            elif message.topic == "pose":
                pose = read_pose(message.data)
                poses.setdefault(pose.frame, []).append(_Arrived((len(odometry), message.log_ns), pose.pose))
        except FormatError:
            continue
    if len(odometry) < _MIN_SAMPLES or not sent:
        raise FileError(
            f"nothing can be identified from {len(odometry)} odometry samples and {len(sent)} commands "
            f"(at least {_MIN_SAMPLES} samples, and the commands that the gate accepted, on rover/cmd_out)"
        )

    def stamp_ns(place: int, arrival_ns: int) -> int:
        return arrival_ns - min(offsets_ns[max(place - _NEAR, 0) : place + _NEAR])

    zero_ns = int(odometry[0][0])
    commands = _table(sent, zero_ns, 3)
    samples = _table(odometry, zero_ns, 6)
    frame, found = _of_one_frame(poses)
    outside = _table([(stamp_ns(*seen), *pose) for seen, pose in found], zero_ns, 4)
    samples[:, 0] = _measured(samples[:, 0])
    if robot is not None and robot.odometry.speed_mean_s:
        samples = samples[np.diff(samples[:, 0], prepend=-math.inf) > 0.0]
        t, x, y, theta = samples[:, :4].T
        slope_x, slope_y = np.gradient(x, t), np.gradient(y, t)
        samples[:, 4] = np.cos(theta) * slope_x + np.sin(theta) * slope_y
        samples[:, 5] = np.gradient(np.unwrap(theta), t)
    own = _track(samples[:, :4])
    return MotionLog(commands[:, 0], commands[:, 1:], own, samples[:, 4:], _track(outside), lasting(frame))


def _of_one_frame(poses: Mapping[str, list[_Arrived]]) -> tuple[str, list[_Arrived]]:
    """Return the most frequent frame and the poses in it; warn of those in others."""
    frame = max(poses, key=lambda name: len(poses[name]), default="")
    if others := {name: len(found) for name, found in poses.items() if name != frame}:
        words = ", ".join(f"{count} in frame {name!r}" for name, count in others.items())
        _log.warning("%s", printable(f"external poses are used in frame {frame!r} only; left out: {words}"))
    return frame, poses.get(frame, [])


def _table(rows: Sequence[tuple[float, ...]], zero_ns: int, width: int) -> FloatArray:
    """Return finite rows by rising time, the first column in s."""
    table = np.array([((row[0] - zero_ns) * 1e-9, *row[1:]) for row in rows]).reshape(-1, width)
    table = table[np.isfinite(table).all(axis=1)]
    ordered: FloatArray = table[np.argsort(table[:, 0], kind="stable")]
    return ordered


def _measured(arrived: FloatArray) -> FloatArray:
    """Return when samples were measured that arrived at ``arrived`` (n,), rising, in s.

    A base measures at a regular cycle, and its reports arrive with varying delays. The cycle is the line that
    no report precedes and that is nearest to all. Without such a cycle the times are unchanged.
    """
    lag = min(_LAG, len(arrived) - 1)
    slope, start = float(np.median(arrived[lag:] - arrived[:-lag])) / lag, float(arrived[0])
    if not slope > 0.0:
        return arrived
    for _ in range(5):
        count = np.rint((arrived - start) / slope)
        slope, start = np.polyfit(count, arrived, 1)
    # Maximise the mean of start + slope · count, which no arrival is before.
    table = np.column_stack([np.ones(len(count)), count])
    line = linprog(-table.mean(axis=0), A_ub=table, b_ub=arrived, bounds=(None, None))
    late = arrived - table @ line.x if line.success else np.full(1, math.inf)
    if late.max() > 0.75 * line.x[1] or (np.diff(count) < 1.0).any():
        return arrived
    measured: FloatArray = arrived - late
    return measured


def _track(table: FloatArray) -> Track:
    poses = table[:, 1:4].copy()
    poses[:, 2] = np.unwrap(poses[:, 2])
    return Track(table[:, 0], poses)
