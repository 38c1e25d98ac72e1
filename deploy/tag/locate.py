"""Pose of the base in the plane from the corners of tags in one picture.

Heights and mounts are known, so three numbers are left: x, y and heading. They minimise the distance in the
picture between the corners that were found and those that the pose predicts.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import cv2
import numpy as np
from scipy.optimize import least_squares

from deploy.tag.detector import Detection
from deploy.tag.tag_map import CameraFile, Floats, Intrinsics, TagMap
from rover_ncp.core.geometry import Pose, near, wrap_angle

OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Turns OpenCV's axes of a camera (right, down, ahead) into those of a mount (forward, left, up)."""
PIXEL = 0.3
"""Least standard deviation of a corner, pixels: what AprilTag 3 reaches on good pictures."""
MAX_PIXELS = 1.5
"""Largest root mean square of a tag's corner errors, pixels: beyond, its size, place or id is wrong."""
FLOOR_M, FLOOR_RAD = 0.002, 0.003
"""Standard deviations that more corners do not lower: errors of the map and of the mount."""
AMBIGUOUS = 12.0
"""A second pose may be the true one if the sum of its squared errors is larger than that of the best by less
than this, in squared standard deviations of a corner: for one tag about twice the errors."""
APART_M, APART_RAD = 0.03, 0.05
"""Poses closer than this are one."""
BEHIND = 1e3
"""Predicted place, in focal lengths, of a corner that is not in front of the camera."""


WIDE = 4.0
"""Distance of a corner from the middle, in focal lengths (76°), beyond which its place is not sure."""


class Rejection(StrEnum):
    """Why a picture gives no pose."""

    FROZEN = "the camera repeats one picture"
    OLD = "the picture is too old"
    DARK = "the picture is dark: is the lens covered?"
    BRIGHT = "the picture is over-exposed"
    NO_TAG = "no tag of the map in the picture"
    TWICE = "a tag is in the picture twice: take one of the two prints away"
    DISAGREE = "tags disagree: the size, place or id of one is wrong, or the camera's intrinsics or mount"
    MISFIT = "the tag does not fit: its size, place or id is wrong, or the camera's intrinsics or mount"
    AMBIGUOUS = "two poses fit about as well"
    TILTED = "the board hangs sideways or upside down, or the camera's mount is wrong"


@dataclass(frozen=True)
class Located:
    """A pose with its 3 × 3 covariance (x, y, theta) from the tags ``ids``; ``rms`` of corners in pixels."""

    pose: Pose
    covariance: Floats
    ids: tuple[int, ...]
    rms: float


class Candidate(NamedTuple):
    """A pose that may be that of the base, and its corners' errors in pixels (2n)."""

    pose: Pose
    errors: Floats
    spread: Floats
    """Covariance (3, 3) of the pose for a standard deviation of one pixel."""
    tilted: bool = False
    """Whether no rover can stand so."""


class Locator:
    """Computes poses for one camera and one map."""

    def __init__(self, camera: CameraFile, tag_map: TagMap) -> None:
        self._tags = {tag.id: tag for tag in tag_map.tags}
        self._on_rover = tag_map.tags_on == "rover"
        self._intrinsics = camera.intrinsics
        self._focal = 0.5 * (camera.intrinsics.fx + camera.intrinsics.fy)
        self._camera_rotation = camera.mount.rotation @ OPTICAL
        self._camera_position = camera.mount.position

    def locate(self, detections: Sequence[Detection]) -> Located | Rejection:
        """Return the pose of the base at the moment of the picture, or why there is none."""
        known = self.known(detections)
        if not known:
            return Rejection.NO_TAG
        found = self.fit(known)
        if isinstance(found, Rejection) or found.rms <= MAX_PIXELS:
            return found
        if len(known) == 1:
            return Rejection.MISFIT
        if len(known) == 2:  # nothing tells which of the two is wrong
            return Rejection.DISAGREE
        # The tag without which the others agree best is left out.
        fits = [self.fit(known[:index] + known[index + 1 :]) for index in range(len(known))]
        agreeing = [each for each in fits if isinstance(each, Located) and each.rms <= MAX_PIXELS]
        return min(agreeing, key=lambda each: each.rms, default=Rejection.DISAGREE)

    def known(self, detections: Sequence[Detection]) -> list[Detection]:
        """Return the tags that are in the map, without those at the edge of a fisheye's picture."""
        found = [each for each in detections if each.id in self._tags]
        return [each for each in found if np.abs(undistorted(self._intrinsics, each.corners)).max() < WIDE]

    def observed(self, detections: Sequence[Detection]) -> tuple[Floats, Floats]:
        """Return the corners of tags of the map in the tags' parent (n × 3), and in the picture (n × 2).

        In m, and in focal lengths without distortion.
        """
        flat = undistorted(self._intrinsics, np.concatenate([each.corners for each in detections]))
        return np.concatenate([self._tags[each.id].corners for each in detections]), flat

    def errors(self, pose: Floats, corners: Floats, flat: Floats) -> Floats:
        """Return how far from `observed` corners those are that a pose predicts, in pixels (2n)."""
        found: Floats = (self._focal * (self.project(pose, corners) - flat)).ravel()
        return found

    def project(self, pose: Floats, corners: Floats) -> Floats:
        """Return where corners (n × 3, in the tags' parent) are in the picture, in focal lengths."""
        c, s = math.cos(pose[2]), math.sin(pose[2])
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        shift = np.array([pose[0], pose[1], 0.0])
        moved = corners @ turn.T + shift if self._on_rover else (corners - shift) @ turn
        seen = (moved - self._camera_position) @ self._camera_rotation
        ahead = seen[:, 2:3]
        flat: Floats = np.where(ahead > 0.01, seen[:, :2] / np.maximum(ahead, 0.01), BEHIND)
        return flat

    def fit(self, detections: Sequence[Detection]) -> Located | Rejection:
        """Return the best pose for tags of the map, however badly they fit."""
        best, *others = sorted(self.candidates(detections), key=lambda each: float(each.errors @ each.errors))
        if best.tilted:
            return Rejection.TILTED
        rms = _corner_rms(best.errors)
        variance = max(rms, PIXEL) ** 2
        for other in others:
            doubtful = float(other.errors @ other.errors - best.errors @ best.errors) < AMBIGUOUS * variance
            if doubtful and not near(best.pose, other.pose, APART_M, APART_RAD):
                return Rejection.AMBIGUOUS
        covariance = variance * best.spread + np.diag(np.square([FLOOR_M, FLOOR_M, FLOOR_RAD]))
        return Located(best.pose, covariance, tuple(each.id for each in detections), rms)

    def candidates(self, detections: Sequence[Detection]) -> list[Candidate]:
        """Return the poses that fit tags of the map best, one for each tilt that the tags may have."""
        observed, found = self.observed(detections), []
        for start in self._starts(detections):
            fit = least_squares(self.errors, start, args=observed, method="lm", max_nfev=100)
            found.append(Candidate(pose_of(fit.x), fit.fun, np.linalg.pinv(fit.jac.T @ fit.jac)))
        return found

    def _starts(self, detections: Sequence[Detection]) -> list[Floats]:
        """Return the poses that fit the largest tag: from afar two tilts of a square look alike."""
        largest = max(detections, key=lambda each: float(np.ptp(each.corners, axis=0).prod()))
        corners, flat = self._tags[largest.id].corners, undistorted(self._intrinsics, largest.corners)
        return [
            self._base(np.asarray(cv2.Rodrigues(turn)[0], np.float64), np.asarray(shift[:, 0], np.float64))
            for turn, shift in tilts(corners, flat)
        ]

    def _base(self, turn: Floats, shift: Floats) -> Floats:
        """Return the base's pose in the plane from that of the tags' parent in the camera (OpenCV's axes)."""
        # In the camera's parent it is the pose of the base in the map, or the inverse of that.
        turn = self._camera_rotation @ turn
        shift = self._camera_position + self._camera_rotation @ shift
        if not self._on_rover:
            turn, shift = turn.T, -turn.T @ shift
        theta = math.atan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
        return np.array([shift[0], shift[1], theta])


def undistorted(intrinsics: Intrinsics, pixels: Floats) -> Floats:
    """Return points of the picture (n × 2) in focal lengths, without distortion."""
    undistort = cv2.fisheye.undistortPoints if intrinsics.model == "fisheye" else cv2.undistortPoints
    flat = undistort(pixels[:, None, :], intrinsics.matrix, np.array(intrinsics.distortion))[:, 0, :]
    return np.asarray(flat, np.float64)


def tilts(corners: Floats, flat: Floats) -> Iterator[tuple[Floats, Floats]]:
    """Yield the turns and places that tags in one plane may have in the camera (OpenCV's axes)."""
    _, turns, shifts, _ = cv2.solvePnPGeneric(
        corners, flat[:, None, :], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
    )
    yield from zip(turns, shifts, strict=True)


def pose_of(numbers: Floats) -> Pose:
    """Return x, y and heading as a pose."""
    x, y, theta = map(float, numbers)
    return Pose(x, y, wrap_angle(theta))


def _corner_rms(errors: Floats) -> float:
    """Return the root mean square of the corners' distances, by their errors in x and y."""
    return float(np.sqrt(2.0 * np.mean(np.square(errors))))
