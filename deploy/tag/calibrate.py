"""Calibration of a camera: intrinsics from pictures of a printed board, mount from a short drive."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from scipy.optimize import least_squares

from deploy.tag.detector import Detection
from deploy.tag.locate import MAX_PIXELS, PIXEL, Located, Locator, corner_rms
from deploy.tag.sheet import BOARD, BOARD_TAG_M
from deploy.tag.tag_map import MOUNT_FIELDS, CameraFile, Floats, Intrinsics, Mount, TagMap
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.errors import UsageError
from rover_ncp.core.geometry import Pose, compose, relative

MIN_PICTURES, MIN_TAGS = 6, 6
"""Fewer pictures, or fewer tags in one, leave the focal length and the distortion undetermined."""
PRIOR = 0.05, 0.05, 0.03, 0.2, 0.2, 0.05
"""Standard deviations of a mount measured by hand: x, y, z in m, yaw, pitch, roll in rad."""
NO_ERRORS, ERROR_PRIOR = (1.0, 1.0, 0.0), (0.05, 0.2, 0.1)
"""Odometry's gains of distance and turn, and the pictures' delay in s, with their standard deviations.

A robot with skid steering slips. At 0.1 rad/s, 10 ms of delay move the mount by a centimetre.
"""
ODOMETRY_STD = 0.002, 0.002, 0.003
"""Standard deviations of a pose of odometry in m and rad: rounding, and the moment of a report."""
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
    """A mount, how late the pictures are against odometry, and the standard deviation of each number."""

    mount: Mount
    deviations: dict[str, float]
    late_s: float
    pictures: int
    """Number of those that were used."""
    rms: float
    """Root mean square of the corners' errors, pixels."""

    def applied(self, camera: CameraFile) -> CameraFile:
        """Return the camera with this mount, and with pictures as old as they were found to be."""
        delay_s = round(camera.delay_s + self.late_s, 4)
        return CameraFile(
            intrinsics=camera.intrinsics, mount=self.mount, delay_s=min(max(delay_s, -2.0), 2.0)
        )


def find_mount(
    camera: CameraFile,
    tag_map: TagMap,
    odometry: Sequence[tuple[int, Pose]],
    pictures: Sequence[tuple[int, Sequence[Detection]]],
) -> MountFound:
    """Return the camera's mount from a drive: odometry and the tags seen, each with its moment in ns.

    ``camera.mount`` is the start, measured by hand. Odometry's gains and the pictures' delay are found, too.
    Raises UsageError when the drive does not determine the mount.
    """
    by_hand = Locator(camera, tag_map)
    (began, _), (ended, _) = odometry[0], odometry[-1]
    times = np.array([at - began for at, _ in odometry]) / NS_PER_S
    poses = np.array([pose for _, pose in odometry])
    poses[:, 2] = np.unwrap(poses[:, 2])
    within = [
        ((at - began) / NS_PER_S, by_hand.known(found)) for at, found in pictures if began <= at <= ended
    ]
    seen = [(at, found) for at, found in within if found]
    if len(seen) < MIN_SAMPLES:
        raise UsageError(f"tags are seen in {len(seen)} pictures, expected {MIN_SAMPLES} or more")
    moments = np.array([at for at, _ in seen])
    odom = _at(moments, times, poses)
    if np.ptp(odom[:, 2]) < MIN_TURN:
        raise UsageError(
            f"the drive turns by {math.degrees(float(np.ptp(odom[:, 2]))):.0f}°, expected "
            f"{math.degrees(MIN_TURN):.0f}° or more with a tag in view"
        )
    fits = [(by_hand.fit(found), Pose(*pose)) for (_, found), pose in zip(seen, odom.tolist(), strict=True)]
    located = [(where, pose) for where, pose in fits if isinstance(where, Located)]
    if not located:
        raise UsageError("the tags fit no pose: is the mount far off, or a tag's size or place wrong?")
    where, pose = min(located, key=lambda each: each[0].rms)
    start = compose(where.pose, relative(pose, Pose(*poses[0].tolist())))  # where the drive begins in the map
    observed = [by_hand.observed(found) for _, found in seen]
    expected = np.array([*camera.mount.model_dump().values(), *NO_ERRORS])
    priors = np.array([*PRIOR, *ERROR_PRIOR])

    path = _at(moments, times, _path(np.array(start), poses, 1.0, 1.0))
    weights = [_weights(by_hand, pose, corners) for pose, corners in zip(path, observed, strict=True)]

    def corner_errors(values: Floats) -> list[Floats]:
        mount = Mount.model_construct(**dict(zip(MOUNT_FIELDS, values, strict=False)))
        locator = Locator(camera.model_copy(update={"mount": mount}), tag_map)
        distance, turn, late = values[6:9]
        path = _at(moments - late, times, _path(values[9:], poses, distance, turn))
        return [locator.errors(pose, *corners) for pose, corners in zip(path, observed, strict=True)]

    def errors(values: Floats) -> Floats:
        weighted = [weight @ each for weight, each in zip(weights, corner_errors(values), strict=True)]
        return np.concatenate([*weighted, (values[:9] - expected) / priors])

    fit = least_squares(errors, np.array([*expected, *start]), loss="soft_l1", x_scale="jac")
    rms = corner_rms(np.concatenate(corner_errors(fit.x)))
    if rms > MAX_PIXELS:
        raise UsageError(f"the drive does not fit the tags ({rms:.1f} px): is the map right, do wheels slip?")
    variance = float(np.mean(np.square(fit.fun)))
    covariance = max(1.0, variance) * np.linalg.pinv(fit.jac.T @ fit.jac)
    deviations = np.sqrt(np.diag(covariance))[[0, 1, 2, 3, 4, 5, 8]]
    return MountFound(
        Mount(**dict(zip(MOUNT_FIELDS, fit.x[:6].tolist(), strict=True))),
        dict(zip((*MOUNT_FIELDS, "late_s"), deviations.tolist(), strict=True)),
        float(fit.x[8]),
        len(seen),
        rms,
    )


def _weights(locator: Locator, pose: Floats, corners: tuple[Floats, Floats]) -> Floats:
    """Return the matrix (2n × 2n) that makes errors of corners independent, with standard deviation 1.

    An error of odometry moves all corners of a picture together.
    """
    exact, step = locator.errors(pose, *corners), 1e-6
    moved = [locator.errors(pose + step * axis, *corners) - exact for axis in np.eye(3)]
    common = np.column_stack(moved) / step * ODOMETRY_STD
    covariance = PIXEL**2 * np.eye(len(exact)) + common @ common.T
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), np.float64)


def _at(moments: Floats, times: Floats, poses: Floats) -> Floats:
    """Return poses (n × 3) at moments, linear between ``times``."""
    return np.column_stack([np.interp(moments, times, column) for column in poses.T])


def _path(start: Floats, odometry: Floats, distance: float, turn: float) -> Floats:
    """Return the path (n × 3) from ``start`` whose steps are those of odometry (n × 3) times the gains."""
    step, before = np.diff(odometry, axis=0), odometry[:-1, 2]
    theta = start[2] + turn * (odometry[:, 2] - odometry[0, 2])
    turned = theta[:-1] - before  # a step's direction in the map less that by odometry
    c, s = distance * np.cos(turned), distance * np.sin(turned)
    moved = np.column_stack([c * step[:, 0] - s * step[:, 1], s * step[:, 0] + c * step[:, 1]])
    return np.column_stack([start[:2] + np.vstack([np.zeros(2), np.cumsum(moved, axis=0)]), theta])
