"""Poses of the base from the pictures of a camera, with a reason for each picture without one."""

import zlib
from collections import Counter

import numpy as np
from pydantic import BaseModel, Field

from deploy.tag.board_locator import locator
from deploy.tag.cameras.camera import Device, Picture
from deploy.tag.detector import Detection, Detector
from deploy.tag.locate import Located, Rejection
from deploy.tag.tag_map import CameraFile, TagMap

DECIMATE = 2.0
"""Tags are searched for in pictures so many times smaller: the drive needs the processor."""
MAX_AGE_S = 1.0
"""An older picture gives no pose: the drive's estimate does not reach back so far."""
DARK, BRIGHT = 20.0, 235.0
"""Mean grey levels beyond which a picture without tags is dark or over-exposed."""


class TagPose(BaseModel):
    """A pose of the base."""

    x: float = Field(description="m")
    y: float = Field(description="m")
    theta: float = Field(description="rad")
    x_std: float = Field(description="m, standard deviation")
    y_std: float = Field(description="m, standard deviation")
    theta_std: float = Field(description="rad, standard deviation")
    tags: tuple[int, ...] = Field(description="ids of the tags that it is from")
    rms_px: float = Field(description="root mean square of the corners' errors in the picture, pixels")


class TagRunResult(BaseModel):
    """Result of ``tag run``."""

    pictures: int = Field(description="pictures that were read")
    poses: int = Field(description="poses that were found and sent")
    rejected: dict[str, int] = Field(
        description="pictures without a pose, by reason; those that cannot be read are not in `pictures`"
    )
    unknown_ids: tuple[int, ...] = Field(description="ids of tags that were seen and are not in the map")
    twice_ids: tuple[int, ...] = Field(description="ids that one picture showed twice, so that none counts")
    seconds: float = Field(description="duration")
    last: TagPose | None = Field(description="the newest pose, or null")


class TagPrintResult(BaseModel):
    """Result of ``tag print``."""

    out: str = Field(description="the PDF")
    ids: tuple[int, ...] = Field(description="ids of the tags")
    size: float | None = Field(description="m, edge of a tag's black square; null for a board")
    page: str = Field(description="the paper")
    board: str | None = Field(description="the board's name, for --map; null for tags")


class TagCalibration(BaseModel):
    """Result of ``tag calibrate``."""

    out: str = Field(description="the camera's file")
    rms_px: float | None = Field(
        description="root mean square of the corners' errors, pixels; null for intrinsics of ROS's file"
    )
    pictures: int = Field(description="pictures that were used")
    fx: float = Field(description="focal length, pixels")
    fx_std: float | None = Field(default=None, description="pixels, standard deviation of `fx`, if measured")
    yaw: float | None = Field(default=None, description="yaw of the mount, rad, if it was measured")
    yaw_std: float | None = Field(default=None, description="rad, standard deviation of `yaw`")


class TagCameras(BaseModel):
    """Result of ``tag cameras``."""

    cameras: tuple[Device, ...] = Field(description="the cameras of this machine")


class Localiser:
    """Turns pictures into poses and counts the others, by reason."""

    def __init__(self, camera: CameraFile, tag_map: TagMap) -> None:
        self._intrinsics = camera.intrinsics
        self._detector, self._locator = Detector(DECIMATE), locator(camera, tag_map)
        self._ids = {tag.id for tag in tag_map.tags}
        self.pictures = self.poses = 0
        self.rejected = Counter[str]()
        self.unknown: set[int] = set()
        self.twice: set[int] = set()
        self.last: Located | None = None
        self.state = "no picture yet"
        """The newest pose or reason, for people."""
        self.detections: list[Detection] = []
        """Tags in the newest picture."""
        self._checksum = 0

    def take(self, picture: Picture, now_ns: int | None = None) -> Located | None:
        """Return the pose of a picture, or None; ``now_ns`` (since the epoch) also rejects old pictures.

        Raises UsageError for a picture of another size than the calibration's.
        """
        self._intrinsics.require_size(picture.grey)
        self.pictures += 1
        found = self._found(picture, now_ns)
        if not isinstance(found, Located):
            self.rejected[found.value] += 1
            self.state = found.value
            return None
        self.poses, self.last = self.poses + 1, found
        self.state = (
            f"x {found.pose.x:.3f} m  y {found.pose.y:.3f} m  θ {found.pose.theta:.3f} rad  "
            f"tags {', '.join(map(str, found.ids))}"
        )
        return found

    def _found(self, picture: Picture, now_ns: int | None) -> Located | Rejection:
        """Return the pose, or why there is none."""
        grey, self.detections = picture.grey, []
        before, self._checksum = self._checksum, zlib.crc32(grey.tobytes())
        if self._checksum == before:  # noise alone changes a picture, so the camera is frozen
            return Rejection.FROZEN
        if now_ns is not None and now_ns - picture.wall_ns > MAX_AGE_S * 1e9:
            return Rejection.OLD
        self.detections = self._detector.detect(grey)
        self.unknown |= {each.id for each in self.detections} - self._ids
        twice = self._detector.twice & self._ids
        self.twice |= twice
        found, level = self._locator.locate(self.detections), float(grey.mean())
        if found is Rejection.NO_TAG and twice:
            return Rejection.TWICE
        if found is Rejection.NO_TAG and level < DARK:
            return Rejection.DARK
        if found is Rejection.NO_TAG and level > BRIGHT:
            return Rejection.BRIGHT
        return found


def tag_pose(found: Located) -> TagPose:
    """Return a pose as a result."""
    x_std, y_std, theta_std = (float(value) for value in np.sqrt(np.diag(found.covariance)))
    return TagPose(
        **found.pose._asdict(),
        x_std=x_std,
        y_std=y_std,
        theta_std=theta_std,
        tags=found.ids,
        rms_px=found.rms,
    )
