"""Calibration of a camera: intrinsics from pictures of a printed board, its yaw from a straight drive."""

import math
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from deploy.tag.board import LAYOUT, board_map
from deploy.tag.board_locator import locator
from deploy.tag.detector import Detection
from deploy.tag.locate import Located
from deploy.tag.tag_map import CameraFile, Intrinsics, TagMap
from rover_ncp.core.config import validated
from rover_ncp.core.errors import UsageError
from rover_ncp.core.geometry import Pose, distance, wrap_angle

MIN_PICTURES, MIN_TAGS = 6, 6
"""Fewer pictures, or fewer tags in one, leave the focal length and the distortion undetermined."""
MIN_TILT_DEG = 17.0
"""Least angle between two pictures' views of the board: from less, any focal length fits."""
MAX_FOCAL_SHARE = 0.01
"""Largest standard deviation of the focal length, as a share of it: distances are wrong by as much."""
STEP_M, MIN_POSES, MIN_WAY_M = 0.03, 10, 0.7
"""Of a drive that measures the yaw: distance of the poses that count, their number, and its length."""
MAX_TURN_DEG = 6.0
"""Change of the heading on a drive that is straight, with the noise of the tags."""
MAX_CORRECTION = math.radians(45.0)


class IntrinsicsFound(NamedTuple):
    """Intrinsics, the root mean square of the corners' errors in pixels, and the pictures that were used.

    ``fx_std`` is the standard deviation of the focal length, pixels.
    """

    intrinsics: Intrinsics
    rms: float
    pictures: int
    fx_std: float


def find_intrinsics(pictures: Sequence[Sequence[Detection]], size: tuple[int, int]) -> IntrinsicsFound:
    """Return the intrinsics from the tags found in pictures of the board; ``size`` is width and height, px.

    Raises UsageError when the pictures do not determine the focal length, ConfigError when no camera fits.
    """
    # The size of its page does not count.
    numbers = Counter(each.id // len(LAYOUT) for tags in pictures for each in tags)
    board = {tag.id: tag for tag in board_map(max(numbers, key=numbers.__getitem__, default=0), "a4").tags}
    points, pixels = [], []
    for tags in pictures:
        seen = [each for each in tags if each.id in board]
        if len(seen) >= MIN_TAGS:
            # On the board x is 0; OpenCV wants points in the plane of its x and y.
            corners = np.concatenate([board[each.id].corners for each in seen])[:, [1, 2, 0]]
            points.append(corners.astype(np.float32))
            pixels.append(np.concatenate([each.corners for each in seen]).astype(np.float32))
    if len(points) < MIN_PICTURES:
        raise UsageError(
            f"the board is seen well in {len(points)} of {len(pictures)} pictures, expected {MIN_PICTURES}: "
            f"show it from near and far, tilted in every direction, at least {MIN_TAGS} tags in a picture"
        )
    rms, matrix, distortion, turns, _, deviations, *_ = cv2.calibrateCameraExtended(
        points,
        pixels,
        size,
        np.eye(3),
        np.zeros(5),  # no guesses: both are results
    )
    normals = np.array([cv2.Rodrigues(turn)[0][:, 2] for turn in turns])
    tilt_deg = math.degrees(math.acos(np.clip((normals @ normals.T).min(), -1.0, 1.0)))
    fx, fx_std = float(matrix[0, 0]), float(deviations[0, 0])
    if tilt_deg < MIN_TILT_DEG or fx_std > MAX_FOCAL_SHARE * fx:
        raise UsageError(
            f"the pictures do not determine the focal length: {fx:.0f} ± {fx_std:.1f} px from views that "
            f"differ by {tilt_deg:.0f}°, expected ± {MAX_FOCAL_SHARE:.0%} and {MIN_TILT_DEG:.0f}°: tilt the "
            "board more, in every direction, near and far"
        )
    found = {
        **dict(zip(("width", "height"), size, strict=True)),
        **{"fx": fx, "fy": float(matrix[1, 1])},
        **{"cx": float(matrix[0, 2]), "cy": float(matrix[1, 2])},
        "distortion": tuple(float(value) for value in np.ravel(distortion)[:5]),
    }
    intrinsics = validated(found, Intrinsics, "the calibration by these pictures")
    return IntrinsicsFound(intrinsics, float(rms), len(points), fx_std)


class YawFound(NamedTuple):
    """The yaw of a camera's mount and its standard deviation, rad, by a drive of ``distance`` m."""

    yaw: float
    deviation: float
    distance: float
    pictures: int
    """Number of those that were used."""


def find_yaw(camera: CameraFile, tag_map: TagMap, pictures: Sequence[Sequence[Detection]]) -> YawFound:
    """Return the yaw of the mount from the tags found in pictures of a straight drive forward, in order.

    The rover drives along its x axis, so its heading by tags errs by as much as the mount's yaw. Raises
    UsageError when the drive does not determine it.
    """
    finds, poses = locator(camera, tag_map), list[Pose]()
    for found in pictures:
        located = finds.locate(found)
        # Pictures of a standing rover count once.
        if isinstance(located, Located) and (not poses or distance(located.pose, poses[-1]) >= STEP_M):
            poses.append(located.pose)
    if len(poses) < MIN_POSES:
        raise UsageError(
            f"the drive has {len(poses)} poses {STEP_M:g} m apart, expected {MIN_POSES}: drive about 1 m "
            "straight ahead, slowly, tags in view"
        )
    places = np.array([pose[:2] for pose in poses])
    middle = places.mean(axis=0)
    ahead = np.linalg.svd(places - middle)[2][0]
    ahead = ahead if ahead @ (places[-1] - places[0]) > 0 else -ahead
    along, aside = (places - middle) @ ahead, (places - middle) @ (-ahead[1], ahead[0])
    errors = np.array([wrap_angle(pose.theta - math.atan2(ahead[1], ahead[0])) for pose in poses])
    correction = wrap_angle(errors[0] + float(np.mean([wrap_angle(each - errors[0]) for each in errors])))
    length, n = float(np.ptp(along)), len(poses)
    turned = math.degrees(float(np.ptp([wrap_angle(each - errors[0]) for each in errors])))
    if length < MIN_WAY_M:
        raise UsageError(f"the rover drove {length:.2f} m, expected about 1 m, {MIN_WAY_M:g} m at least")
    if turned > MAX_TURN_DEG:
        raise UsageError(
            f"the drive was not straight: it turned by {turned:.0f}°, expected {MAX_TURN_DEG:g}° at most"
        )
    if abs(correction) > MAX_CORRECTION:
        raise UsageError(
            f"the camera's yaw is {math.degrees(correction):.0f}° from the file's: drive forward, and write "
            "about the right yaw into the file first"
        )
    of_line = float(np.std(aside)) * math.sqrt(12.0 / n) / length
    deviation = math.hypot(of_line, float(np.std(errors - errors.mean())) / math.sqrt(n))
    return YawFound(wrap_angle(camera.mount.yaw + correction), deviation, length, n)
