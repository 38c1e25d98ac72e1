"""Calibration of a camera: intrinsics from pictures of a printed board, mount from a short drive."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from scipy.optimize import least_squares

from deploy.tag.detector import Detection
from deploy.tag.locate import MAX_PIXELS, PIXEL, Located, Locator, corner_rms
from deploy.tag.sheet import BOARD, BOARD_TAG_M
from deploy.tag.tag_map import MOUNT_FIELDS, CameraFile, Floats, Intrinsics, Mount, TagMap
from rover_ncp.core.errors import UsageError
from rover_ncp.core.geometry import Pose, compose, relative

MIN_PICTURES, MIN_TAGS = 6, 6
"""Fewer pictures, or fewer tags in one, leave the focal length and the distortion undetermined."""
PRIOR = np.array([0.05, 0.05, 0.03, 0.2, 0.2, 0.05])
"""Standard deviations of a mount measured by hand: x, y, z in m, yaw, pitch, roll in rad."""
GAIN_PRIOR = np.array([0.05, 0.2])
"""Standard deviations of odometry's distances and turns, as shares: a robot with skid steering slips."""
MIN_SAMPLES = 20
MIN_TURN = 0.5
"""Least range of headings in the drive, rad: without a turn the camera's place on the rover is not seen."""


class IntrinsicsFound(NamedTuple):
    """Intrinsics, the root mean square of the corners' errors in pixels, and the pictures that were used."""

    intrinsics: Intrinsics
    rms: float
    pictures: int


def find_intrinsics(pictures: Sequence[Sequence[Detection]], size: tuple[int, int]) -> IntrinsicsFound:
    """Return the intrinsics from the tags found in pictures of the board; ``size`` is width and height, px.

    Raises UsageError when too few pictures show enough of the board.
    """
    h = 0.5 * BOARD_TAG_M
    square = np.array([[-h, -h], [h, -h], [h, h], [-h, h]])
    points, pixels = [], []
    for found in pictures:
        seen = [each for each in found if each.id < len(BOARD)]
        if len(seen) >= MIN_TAGS:
            flat = np.concatenate([square + BOARD[each.id] for each in seen])
            points.append(np.column_stack([flat, np.zeros(len(flat))]).astype(np.float32))
            pixels.append(np.concatenate([each.corners for each in seen]).astype(np.float32))
    if len(points) < MIN_PICTURES:
        raise UsageError(
            f"the board is seen well in {len(points)} of {len(pictures)} pictures, expected {MIN_PICTURES}: "
            f"show it from near and far, tilted in every direction, at least {MIN_TAGS} tags in a picture"
        )
    rms, matrix, distortion, _, _ = cv2.calibrateCamera(points, pixels, size, None, None)
    intrinsics = Intrinsics(
        width=size[0],
        height=size[1],
        fx=float(matrix[0, 0]),
        fy=float(matrix[1, 1]),
        cx=float(matrix[0, 2]),
        cy=float(matrix[1, 2]),
        distortion=tuple(float(value) for value in np.ravel(distortion)[:5]),
    )
    return IntrinsicsFound(intrinsics, float(rms), len(points))


class MountFound(NamedTuple):
    """A mount, the standard deviation of each number of it, and the corners' root mean square in pixels."""

    mount: Mount
    deviations: dict[str, float]
    rms: float


def find_mount(
    camera: CameraFile, tag_map: TagMap, samples: Sequence[tuple[Pose, Sequence[Detection]]]
) -> MountFound:
    """Return the camera's mount from the odometry's poses and the tags seen there.

    ``camera.mount`` is the start, measured by hand. Odometry's gains are found, too. Raises UsageError when
    the drive does not determine it.
    """
    first = Locator(camera, tag_map)
    visible = [first.known(found) for _, found in samples]
    shown = [index for index, found in enumerate(visible) if found]
    seen = [(samples[index][0], visible[index]) for index in shown]
    if len(seen) < MIN_SAMPLES:
        raise UsageError(f"tags are seen in {len(seen)} pictures, expected {MIN_SAMPLES} or more")
    headings = np.unwrap([odom.theta for odom, _ in seen])
    if np.ptp(headings) < MIN_TURN:
        raise UsageError(
            f"the drive turns by {math.degrees(float(np.ptp(headings))):.0f}°, expected "
            f"{math.degrees(MIN_TURN):.0f}° or more with a tag in view"
        )
    starts = [(odom, where) for odom, found in seen if isinstance(where := first.fit(found), Located)]
    if not starts:
        raise UsageError("the tags fit no pose: is the mount far off, or a tag's size or place wrong?")
    odom, where = min(starts, key=lambda each: each[1].rms)
    first_odom, steps = samples[0][0], [relative(a, b) for (a, _), (b, _) in pairwise(samples)]
    start = compose(where.pose, relative(odom, first_odom))  # where the drive begins in the map
    observed = [first.observed(found) for _, found in seen]
    by_hand = np.array([getattr(camera.mount, name) for name in MOUNT_FIELDS])

    def errors(values: Floats) -> Floats:
        mount = Mount.model_construct(**dict(zip(MOUNT_FIELDS, values[:6], strict=True)))
        locator = Locator(camera.model_copy(update={"mount": mount}), tag_map)
        path = _path(values[6:9], np.array(steps), *values[9:])[shown]
        parts = [locator.errors(pose, *corners) / PIXEL for pose, corners in zip(path, observed, strict=True)]
        return np.concatenate([*parts, (values[:6] - by_hand) / PRIOR, (values[9:] - 1.0) / GAIN_PRIOR])

    fit = least_squares(errors, np.array([*by_hand, *start, 1.0, 1.0]), loss="soft_l1", x_scale="jac")
    rms = PIXEL * corner_rms(fit.fun[:-8])
    if rms > MAX_PIXELS:
        raise UsageError(f"the drive does not fit the tags ({rms:.1f} px): is the map right, do wheels slip?")
    covariance = max(1.0, (rms / PIXEL) ** 2) * np.linalg.pinv(fit.jac.T @ fit.jac)
    deviations = np.sqrt(np.diag(covariance))[:6]
    return MountFound(
        Mount(**dict(zip(MOUNT_FIELDS, fit.x[:6].tolist(), strict=True))),
        dict(zip(MOUNT_FIELDS, deviations.tolist(), strict=True)),
        rms,
    )


def _path(start: Floats, steps: Floats, distance: float, turn: float) -> Floats:
    """Return poses (n + 1, 3) by steps (n, 3), each in the frame of the pose before it, times the gains."""
    theta = start[2] + np.append(0.0, turn * np.cumsum(steps[:, 2]))
    c, s = np.cos(theta[:-1]), np.sin(theta[:-1])
    ahead, left = distance * steps[:, 0], distance * steps[:, 1]
    moved = np.cumsum(np.column_stack([c * ahead - s * left, s * ahead + c * left]), axis=0)
    return np.column_stack([start[:2] + np.vstack([np.zeros(2), moved]), theta])
