"""Pose of the base before a board, in the board's frame: by the board's pose in space.

Neither the heights of camera and board nor their tilts have to be known. A mount that is wrong moves all
poses by one constant motion in the rover's frame, so that a place which the same camera taught is right.
"""

import math
from collections.abc import Sequence

import cv2
import numpy as np

from deploy.tag.detector import Detection
from deploy.tag.locate import (
    APART_M,
    APART_RAD,
    FLOOR_M,
    FLOOR_RAD,
    PIXEL,
    Located,
    Locator,
    Rejection,
    corner_rms,
    doubtful,
)
from deploy.tag.tag_map import CameraFile, Floats, TagMap
from rover_ncp.core.geometry import Pose, near, wrap_angle

TILT_RAD = math.radians(30.0)
"""Largest tilt of the rover in the board's frame: beyond, the board hangs sideways or upside down."""
STEP = 1e-6
"""Of numeric derivatives, rad and m."""


def locator(camera: CameraFile, tag_map: TagMap) -> Locator:
    """Return what computes poses for a camera and its tags."""
    return BoardLocator(camera, tag_map) if tag_map.tags_on == "board" else Locator(camera, tag_map)


class BoardLocator(Locator):
    """Computes poses for one camera and one board."""

    def fit(self, detections: Sequence[Detection]) -> Located | Rejection:
        """Return the best pose for tags of the board, however badly they fit."""
        corners, flat = self.observed(detections)
        _, turns, shifts, _ = cv2.solvePnPGeneric(
            corners, flat[:, None, :], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
        )
        fits = []
        for turn, shift in zip(turns, shifts, strict=True):
            refined = cv2.solvePnPRefineLM(corners, flat, np.eye(3), None, turn.copy(), shift.copy())
            space = np.concatenate([np.ravel(each) for each in refined]).astype(np.float64)
            errors, jacobian = self._errors(space, corners, flat)
            fits.append((errors, jacobian, space))
        (errors, jacobian, space), *others = sorted(fits, key=lambda fit: float(fit[0] @ fit[0]))
        if self._tilt(space) > TILT_RAD:
            return Rejection.TILTED
        x, y, theta = map(float, self._planar(space))
        pose = Pose(x, y, wrap_angle(theta))
        for other, _, elsewhere in others:
            same = near(pose, Pose(*self._planar(elsewhere)), APART_M, APART_RAD)
            if not same and doubtful(errors, other):
                return Rejection.AMBIGUOUS
        rms = corner_rms(errors)
        of_space = max(rms, PIXEL) ** 2 * np.linalg.pinv(jacobian.T @ jacobian)
        steps = STEP * np.eye(6)
        change = [self._planar(space + step) - self._planar(space - step) for step in steps]
        planar = np.array([[dx, dy, wrap_angle(dt)] for dx, dy, dt in change]).T / (2.0 * STEP)
        covariance = planar @ of_space @ planar.T + np.diag(np.square([FLOOR_M, FLOOR_M, FLOOR_RAD]))
        return Located(pose, covariance, tuple(each.id for each in detections), rms)

    def _errors(self, space: Floats, corners: Floats, flat: Floats) -> tuple[Floats, Floats]:
        """Return the corners' errors in pixels (2n), and how they change with the pose in space (2n × 6)."""
        found, jacobian = cv2.projectPoints(corners, space[:3], space[3:], np.eye(3), None)
        errors: Floats = self._focal * (found[:, 0, :] - flat).ravel()
        return errors, self._focal * np.asarray(jacobian, np.float64)[:, :6]

    def _base_turn(self, space: Floats) -> tuple[Floats, Floats]:
        """Return the rotation of the base and the position of the camera, both in the board."""
        turn = np.asarray(cv2.Rodrigues(space[:3])[0], np.float64)
        return turn.T @ self._camera_rotation.T, -turn.T @ space[3:]

    def _tilt(self, space: Floats) -> float:
        return math.acos(float(np.clip(self._base_turn(space)[0][2, 2], -1.0, 1.0)))

    def _planar(self, space: Floats) -> Floats:
        """Return x, y and heading of the base in the board's horizontal plane."""
        turn, camera = self._base_turn(space)
        theta = math.atan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
        c, s, (mx, my, _) = math.cos(theta), math.sin(theta), self._camera_position
        return np.array([camera[0] - c * mx + s * my, camera[1] - s * mx - c * my, theta])
