"""Pose of the base before a board, in the board's frame: by the board's pose in space.

Neither the heights of camera and board nor their tilts have to be known. A mount that is wrong moves all
poses by one constant motion in the rover's frame, so that a place which the same camera taught is right.
"""

import math
from collections.abc import Sequence

import cv2
import numpy as np

from deploy.tag.detector import Detection
from deploy.tag.locate import Candidate, Locator, pose_of, tilts
from deploy.tag.tag_map import CameraFile, Floats, TagMap
from rover_ncp.core.geometry import wrap_angle

TILT_RAD = math.radians(30.0)
"""Largest tilt of the rover in the board's frame: beyond, the board hangs sideways or upside down."""
STEP = 1e-6
"""Of numeric derivatives, rad and m."""


def locator(camera: CameraFile, tag_map: TagMap) -> Locator:
    """Return what computes poses for a camera and its tags."""
    return BoardLocator(camera, tag_map) if tag_map.tags_on == "board" else Locator(camera, tag_map)


class BoardLocator(Locator):
    """Computes poses for one camera and one board."""

    def candidates(self, detections: Sequence[Detection]) -> list[Candidate]:
        """Return the poses that fit tags of the board best, one for each tilt that it may have."""
        corners, flat = self.observed(detections)
        found = []
        for turn, shift in tilts(corners, flat):
            refined = cv2.solvePnPRefineLM(corners, flat, np.eye(3), None, turn.copy(), shift.copy())
            space = np.concatenate([np.ravel(each) for each in refined]).astype(np.float64)
            errors, jacobian = self._errors(space, corners, flat)
            change = [self._planar(space + step) - self._planar(space - step) for step in STEP * np.eye(6)]
            planar = np.array([[dx, dy, wrap_angle(dt)] for dx, dy, dt in change]).T / (2.0 * STEP)
            spread = planar @ np.linalg.pinv(jacobian.T @ jacobian) @ planar.T
            tilted = self._tilt(space) > TILT_RAD
            found.append(Candidate(pose_of(self._planar(space)), errors, spread, tilted))
        return found

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
