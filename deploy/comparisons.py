"""Comparisons of a check: the motion that a gyro and external poses show, beside that of odometry. Pure.

Each returns whether it passed, and its finding: what was measured, and what would be right. Times are those
of measurement, in s on the driver's clock.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.core.geometry import Pose, Velocity, relative, wrap_angle
from rover_ncp.wire.messages import GYRO_GAP_S

FloatArray = NDArray[np.float64]
Answer = tuple[bool, str]

WAY_SHARE = 0.2
"""How far a distance by external poses and by odometry may differ, as a share."""
TURN_SHARES, SKID_TURN_SHARES = (0.8, 1.25), (0.6, 1.6)
"""Turn by another sensor over odometry's; a skid-steered robot with weight off its middle turns up to 1.5."""
BEARING_RAD = math.radians(20.0)
"""Largest angle between the direction in which poses move and their heading, on a straight way."""
MAX_GYRO_LAG_S, MAX_POSE_LAG_S = 0.2, 0.25
"""Largest lag behind odometry; a drive expects poses 0.05 s late, with a deviation of 0.05 s."""
MAX_GYRO_BIAS_RAD_S = 0.4
"""Twice the deviation that the estimator expects."""
MIN_POSE_HZ, MAX_SCATTER_M = 1.0, 0.1
MIN_SAMPLES = 5
"""Fewer samples of a motion show nothing."""
ROOM_M, ROOM_SHARE = 0.03, 0.3
"""Error of a laser's range, and share by which the room to something oblique may change otherwise."""
JUMP_M, JUMP_RAD = 0.05, 0.1
"""Beyond twice the commanded motion, odometry that moves farther between two samples jumps."""
NOTHING = 0.1
"""A sensor that shows a smaller share of odometry's motion shows none."""
_LAGS_S = np.arange(-0.3, 1.0, 0.01)
_SPAN = 9.0
"""Squared standard deviations by which the sum of squares may exceed its minimum: 3 sigma of the lag."""
_LARGEST = 1e9
"""No sensor shows more, in m or rad; squares of it are finite."""
_NOISE = 1e-4
"""Least noise that a fit assumes, m and rad."""


@dataclass
class Samples:
    """What arrived in one step of a check."""

    odometry: list[tuple[float, Pose]] = field(default_factory=list)
    gyro: list[tuple[float, float]] = field(default_factory=list)
    """Each rate (rad/s) is the mean since the reading before."""
    poses: list[tuple[float, Pose]] = field(default_factory=list)


class Fit(NamedTuple):
    """A sensor's motion over odometry's, each direction by itself, and how late the sensor shows it."""

    scales: FloatArray
    std: float
    """Standard deviation of the scales."""
    lag_s: float
    lags_s: tuple[float, float]
    """The interval in which the lag is."""

    @property
    def late(self) -> str:
        """The lag in words."""
        low, high = self.lags_s
        return f"{self.lag_s:.2f} s late (between {low:.2f} and {high:.2f} s)"


def jump(samples: Samples, command: Velocity) -> str:
    """Return in words the first jump of odometry between two samples of a motion; "" without one."""
    for (before_s, before), (now_s, now) in pairwise(samples.odometry):
        span_s, moved = now_s - before_s, relative(before, now)
        way_m, turned = math.hypot(moved.x, moved.y), abs(moved.theta)
        if (
            way_m > JUMP_M + 2.0 * abs(command.v) * span_s
            or turned > JUMP_RAD + 2.0 * abs(command.omega) * span_s
        ):
            by = f"{way_m:.3g} m and {turned:.3g} rad within {span_s:.2f} s"
            return f"the pose of odometry jumps by {by}: something sets it anew, or two publishers send it"
    return ""


def gyro_at_rest(rest: Samples) -> Answer:
    """Check that the readings of a gyro come without gaps while the robot stands."""
    if not rest.gyro:
        return False, "no reading arrives on imu"
    gap_s = _longest_gap_s(rest.gyro, rest.odometry)
    words = f"{_bias(rest):+.3g} rad/s at rest, longest gap {gap_s:.2f} s (at most {GYRO_GAP_S:g} s)"
    return gap_s <= GYRO_GAP_S, words


def gyro_in_turn(rest: Samples, turn: Samples, shares: tuple[float, float], *, on_floor: bool) -> Answer:
    """Compare a gyro with odometry on a turn: sign, scale, unit and lag."""
    if len(turn.gyro) < MIN_SAMPLES:
        return False, f"{len(turn.gyro)} readings arrived during the turn, expected one with each odometry"
    times = np.array([at_s for at_s, _ in turn.gyro])
    rates = np.array([rate for _, rate in turn.gyro]) - _bias(rest)
    angles = np.concatenate([[0.0], np.cumsum(rates[1:] * np.diff(times))])
    fit = _fit(turn, _turned(turn), times, angles[:, None])
    turned = float(_turned(turn)[-1])
    share = float(fit.scales[0])
    words = f"the gyro turned {share * turned:.3g} rad where odometry turned {turned:.3g} rad"
    bias = f"{_bias(rest):+.3g} rad/s at rest (at most {MAX_GYRO_BIAS_RAD_S:g})"
    biased = abs(_bias(rest)) > MAX_GYRO_BIAS_RAD_S
    if abs(share) < NOTHING:
        return (False, f"{words}, {bias}") if biased else _still(words, on_floor)
    low, high = shares
    right = f"{low:g} to {high:g} times as much"
    in_degrees = low <= abs(share) / math.degrees(1.0) <= high
    problems = {
        "it is in degrees per second, expected radians per second": in_degrees,
        "its sign is wrong, expected a turn to the left as positive (axis z up)": share < 0.0,
        f"expected {right}; its scale or its axis is wrong": not (in_degrees or low <= abs(share) <= high),
        bias: biased and not in_degrees,
    }
    if found := [problem for problem, there in problems.items() if there]:
        return False, f"{words}: {'; '.join(found)}"
    expected = f"{words} (right: {right}), {fit.late}, at most {MAX_GYRO_LAG_S:g} s"
    return fit.lags_s[0] <= MAX_GYRO_LAG_S, expected


def poses_at_rest(rest: Samples, frames: Sequence[str], age_s: float) -> Answer:
    """Check rate, age and frame of external poses; ``age_s`` is arrival minus stamp."""
    seconds = rest.odometry[-1][0] - rest.odometry[0][0] if len(rest.odometry) > 1 else 0.0
    rate = len(rest.poses) / seconds if seconds else 0.0
    named = ", ".join(frame or "without a name" for frame in sorted(set(frames)))
    expected = "deploy expects course, and with --to the place's frame"
    words = f"{rate:.1f} poses a second (at least {MIN_POSE_HZ:g}) in the frame {named} ({expected})"
    if len(set(frames)) > 1:
        return False, f"{words}: expected one frame; do two localisers send pose?"
    scatter_m = float(np.hypot(*np.std([(pose.x, pose.y) for _, pose in rest.poses], axis=0)))
    words += f", {age_s:.3g} s old by their stamps, scatter {scatter_m:.3g} m (at most {MAX_SCATTER_M:g} m)"
    return rate >= MIN_POSE_HZ and scatter_m <= MAX_SCATTER_M, words


def poses_on_way(straight: Samples, *, on_floor: bool) -> Answer:
    """Compare external poses with odometry on a straight way: scale, heading and lag."""
    if len(straight.poses) < MIN_SAMPLES:
        return _too_few(len(straight.poses))
    times = np.array([at_s for at_s, _ in straight.poses])
    places = np.array([(pose.x, pose.y) for _, pose in straight.poses])
    way = _driven(straight)
    fit = _fit(straight, way, times, places)
    scale, driven = float(np.hypot(*fit.scales)), float(way[-1])
    words = f"the poses moved {scale * driven:.3g} m where odometry drove {driven:.3g} m"
    if scale < NOTHING + 2.0 * fit.std:
        return _still(words, on_floor)
    headings = np.array([pose.theta for _, pose in straight.poses])
    heading = math.atan2(np.sin(headings).sum(), np.cos(headings).sum())
    bearing = wrap_angle(math.atan2(fit.scales[1], fit.scales[0]) - heading)
    words += f", {math.degrees(bearing):+.0f}° from their heading"
    if abs(bearing) - 2.0 * fit.std / scale > BEARING_RAD:
        limit = f"expected at most {math.degrees(BEARING_RAD):.0f}°"
        return False, f"{words}: {limit}; the yaw of the camera's mount is wrong, or the frame is mirrored"
    if abs(scale - 1.0) - 2.0 * fit.std > WAY_SHARE:
        return False, f"{words}: expected ±{WAY_SHARE:.0%}; is the size of tags or map wrong?"
    words += f", {fit.late}"
    if fit.lags_s[0] > MAX_POSE_LAG_S:
        limit = f"expected at most {MAX_POSE_LAG_S:g} s"
        return False, f"{words}: {limit}; stamp a pose with the time of its picture"
    return True, f"{words}; right: ±{WAY_SHARE:.0%}, at most {MAX_POSE_LAG_S:g} s"


def poses_in_turn(turn: Samples, shares: tuple[float, float], *, on_floor: bool) -> Answer:
    """Compare the heading of external poses with odometry's on a turn: sign and scale."""
    if len(turn.poses) < MIN_SAMPLES:
        return _too_few(len(turn.poses))
    times = np.array([at_s for at_s, _ in turn.poses])
    headings = np.unwrap(np.array([pose.theta for _, pose in turn.poses]))
    turned = _turned(turn)
    fit = _fit(turn, turned, times, headings[:, None])
    share, angle = float(fit.scales[0]), float(turned[-1])
    words = f"the poses turned {share * angle:.3g} rad where odometry turned {angle:.3g} rad"
    low, high = shares
    if abs(share) < NOTHING + 2.0 * fit.std:
        return _still(words, on_floor)
    if share < 0.0:
        return False, f"{words}: their frame is mirrored, expected x, y and z as a right hand's, z up"
    ok = low - 2.0 * fit.std <= share <= high + 2.0 * fit.std
    return ok, f"{words} (right: {low:g} to {high:g} times as much)"


def room_on_way(
    before: Sequence[float | None], after: Sequence[float | None], driven_m: float, *, on_floor: bool
) -> Answer:
    """Compare the room (ahead, behind) that a laser shows with a straight way."""
    changes = {
        name: sign * (was - now)
        for name, sign, was, now in zip(("ahead", "behind"), (1.0, -1.0), before, after, strict=True)
        if was is not None and now is not None
    }
    if not changes:
        return True, "not known: the laser shows nothing ahead or behind, or is not described"
    shown = ", ".join(f"{change:+.2f} m {name}" for name, change in changes.items())
    words = f"the laser shows a way of {shown} where odometry drove {driven_m:.2f} m"
    limit_m = ROOM_M + ROOM_SHARE * driven_m
    if any(abs(change - driven_m) <= limit_m for change in changes.values()):
        return True, words
    if all(abs(change) <= ROOM_M for change in changes.values()):
        return _still(words, on_floor)
    return False, f"{words}: scan.yaw_deg is wrong, or something else moved"


def _still(words: str, on_floor: bool) -> Answer:
    if on_floor:
        return False, f"{words}: expected about the same; the sensor is not on the robot, or repeats itself"
    return True, f"{words}: not known, as on blocks; --on-floor compares them"


def _too_few(count: int) -> Answer:
    return True, f"not known: {count} poses during the motion, expected {MIN_SAMPLES} or more"


def _bias(rest: Samples) -> float:
    return float(np.mean([rate for _, rate in rest.gyro])) if rest.gyro else 0.0


def _longest_gap_s(readings: Sequence[tuple[float, float]], odometry: Sequence[tuple[float, Pose]]) -> float:
    times = [at_s for at_s, _ in readings]
    ends = [at_s for at_s, _ in (odometry[0], odometry[-1])] if odometry else []
    return float(np.diff(sorted([*times, *ends])).max())


def _turned(samples: Samples) -> FloatArray:
    """Return odometry's angle at each sample, from 0 on."""
    headings = np.unwrap(np.array([pose.theta for _, pose in samples.odometry]))
    return np.asarray(headings - headings[0], np.float64)


def _driven(samples: Samples) -> FloatArray:
    """Return odometry's distance forward at each sample, from 0 on."""
    poses = [pose for _, pose in samples.odometry]
    steps = [relative(before, now).x for before, now in pairwise(poses)]
    return np.concatenate([[0.0], np.cumsum(steps)])


def _fit(samples: Samples, reference: FloatArray, times: FloatArray, shown: FloatArray) -> Fit:
    """Fit ``shown`` (samples, directions) to odometry's motion, by scales and one lag (least squares)."""
    at_s = np.array([at_s for at_s, _ in samples.odometry])
    shown = np.clip(shown, -_LARGEST, _LARGEST)
    shown = shown - shown.mean(axis=0)
    sums, scales, spreads = [], [], []
    for lag_s in _LAGS_S:
        motion = np.interp(times - lag_s, at_s, reference)
        motion = motion - motion.mean()
        spread = max(float(motion @ motion), _NOISE**2)
        scale = motion @ shown / spread
        sums.append(float(np.sum((shown - motion[:, None] * scale) ** 2)))
        scales.append(scale)
        spreads.append(spread)
    best = int(np.argmin(sums))
    variance = max(sums[best] / max(shown.size - 3, 1), _NOISE**2)
    inside = _LAGS_S[(np.array(sums) - sums[best]) / variance <= _SPAN]
    std = math.sqrt(variance / spreads[best])
    return Fit(scales[best], std, float(_LAGS_S[best]), (float(inside.min()), float(inside.max())))
