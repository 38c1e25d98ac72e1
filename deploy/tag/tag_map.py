"""Files of the tag commands: where the tags are, and what the camera is.

A mount is a pose in space: x forward, y left, z up in m; yaw, pitch, roll in rad about z, y, x (REP-103), so
that a positive pitch points down. A camera looks along its x axis, a tag's printed side faces along its own.
"""

import math
from collections import Counter
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from rover_ncp.core.config import StrictModel
from rover_ncp.core.errors import UsageError

Floats = NDArray[np.float64]
Coordinate = Annotated[float, Field(ge=-1000.0, le=1000.0, description="m")]
Turn = Annotated[float, Field(ge=-2 * math.pi, le=2 * math.pi, description="rad")]

FAMILY = "tag36h11"
IDS = 587
"""Number of tags in the family."""
MAX_DISTORTION = 1e4
"""Rational models of wide lenses have coefficients of some hundreds."""
FLAT_M = 1e-6
"""Largest distance of a corner from the plane of its board."""
FOCAL = 0.1, 20.0
"""Least and largest focal length, in longer sides of the picture: views of 157° and 3°."""


class Mount(StrictModel):
    """Pose in space: of a camera or a tag, in the map or on the rover."""

    x: Coordinate
    y: Coordinate
    z: Coordinate
    yaw: Turn = 0.0
    pitch: Turn = 0.0
    roll: Turn = 0.0

    @property
    def rotation(self) -> Floats:
        """3 × 3 matrix that turns vectors of the mounted body into those of its parent."""
        turns: Floats = Rotation.from_euler("ZYX", [self.yaw, self.pitch, self.roll]).as_matrix()
        return turns

    @property
    def position(self) -> Floats:
        """Origin in the parent, m."""
        return np.array([self.x, self.y, self.z])


MOUNT_FIELDS = tuple(Mount.model_fields)


class Tag(Mount):
    """A printed tag: its pose, and the edge of its black square in m."""

    id: int = Field(ge=0, lt=IDS)
    size: float = Field(gt=0.005, le=5.0, description="m")

    @property
    def corners(self) -> Floats:
        """Corners in the tag's parent, 4 × 3 in m: bottom left, bottom right, top right, top left."""
        h = 0.5 * self.size
        # The reader's right is the tag's left hand: +y.
        own = np.array([[0.0, -h, -h], [0.0, h, -h], [0.0, h, h], [0.0, -h, h]])
        corners: Floats = own @ self.rotation.T + self.position
        return corners


class TagMap(StrictModel):
    """The tags that a camera may see, and the frame of their poses.

    The tags are in the frame ``frame`` and the camera is on the rover; or the camera is in that frame (on a
    ceiling, looking down) and the tags are on the rover, in base_link: ``tags_on: rover``. With
    ``tags_on: board`` the tags are on one flat board that hangs upright at a height that is not known.
    """

    frame: str = Field(default="map", min_length=1, max_length=64)
    tags_on: Literal["ground", "rover", "board"] = "ground"
    tags: tuple[Tag, ...] = Field(min_length=1, max_length=200)

    @model_validator(mode="after")
    def _no_id_twice(self) -> Self:
        twice = [tag for tag, count in Counter(tag.id for tag in self.tags).items() if count > 1]
        if twice:
            raise ValueError(f"tags with the same id: {', '.join(map(str, twice))}")
        return self

    @model_validator(mode="after")
    def _board_is_flat(self) -> Self:
        leaning = [tag.id for tag in self.tags if np.abs(tag.corners[:, 0]).max() > FLAT_M]
        if self.tags_on == "board" and leaning:
            found = ", ".join(map(str, leaning))
            raise ValueError(f"tags_on: board: expected tags at x 0 without yaw and pitch, not so: {found}")
        return self


class Intrinsics(StrictModel):
    """A camera's picture: its size in pixels, and OpenCV's camera matrix and distortion.

    ``pinhole`` has 4, 5, 8, 12 or 14 coefficients (plumb bob, rational and their extensions), ``fisheye`` has
    4 (equidistant).
    """

    width: int = Field(ge=16, le=20_000)
    height: int = Field(ge=16, le=20_000)
    fx: float = Field(gt=0)
    fy: float = Field(gt=0)
    cx: float
    cy: float
    model: Literal["pinhole", "fisheye"] = "pinhole"
    distortion: tuple[float, ...] = (0.0,) * 5

    def require_size(self, grey: NDArray[np.uint8]) -> None:
        """Raise UsageError if a picture has another size than those of the calibration."""
        if grey.shape != (self.height, self.width):
            raise UsageError(
                f"the camera sends {grey.shape[1]} × {grey.shape[0]} pixels, its calibration is for "
                f"{self.width} × {self.height}"
            )

    @model_validator(mode="after")
    def _is_of_a_camera(self) -> Self:
        counts = {"pinhole": (4, 5, 8, 12, 14), "fisheye": (4,)}[self.model]
        if len(self.distortion) not in counts:
            expected = " or ".join(map(str, counts))
            raise ValueError(
                f"{len(self.distortion)} coefficients of a {self.model} camera, expected {expected}"
            )
        if not (np.abs(self.distortion) <= MAX_DISTORTION).all():
            raise ValueError(f"a coefficient of the distortion is beyond ±{MAX_DISTORTION:g}")
        least, most = (share * max(self.width, self.height) for share in FOCAL)
        if not (least <= self.fx <= most and 0.5 <= self.fy / self.fx <= 2.0):
            raise ValueError(
                f"focal lengths {self.fx:g} and {self.fy:g} do not fit a picture of {self.width} × "
                f"{self.height} pixels, expected {least:g} to {most:g}, and about equal ones"
            )
        if not (0.0 <= self.cx <= self.width and 0.0 <= self.cy <= self.height):
            raise ValueError(
                f"the principal point {self.cx:g}, {self.cy:g} is outside the picture of {self.width} × "
                f"{self.height} pixels"
            )
        return self

    @property
    def matrix(self) -> Floats:
        """OpenCV's 3 × 3 camera matrix, pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def pixels(self, flat: Floats) -> Floats:
        """Return points (n × 2) in pixels, from focal lengths, without distortion."""
        found: Floats = flat @ self.matrix[:2, :2].T + self.matrix[:2, 2]
        return found


class CameraFile(StrictModel):
    """A camera: intrinsics, settings, and its mount on the rover (or in the map, for tags on the rover)."""

    intrinsics: Intrinsics
    mount: Mount
    rate_hz: float | None = Field(default=None, gt=0, le=1000, description="pictures per second of a device")
    focus: float | None = Field(
        default=None,
        ge=0,
        le=10_000,
        description="focus of a device in its driver's units, with its autofocus off",
    )
