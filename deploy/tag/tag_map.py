"""Files of the tag commands: where the tags are, and what the camera is.

A mount is a pose in space: x forward, y left, z up in m; yaw, pitch, roll in rad about z, y, x (REP-103), so
that a positive pitch points down. A camera looks along its x axis, a tag's printed side faces along its own.
"""

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from rover_ncp.core.config import StrictModel, read_yaml, validated
from rover_ncp.core.errors import ConfigError
from rover_ncp.core.files import read_text

Floats = NDArray[np.float64]
Coordinate = Annotated[float, Field(ge=-1000.0, le=1000.0, description="m")]
Turn = Annotated[float, Field(ge=-2 * math.pi, le=2 * math.pi, description="rad")]

FAMILY = "tag36h11"
IDS = 587
"""Number of tags in the family."""


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
    ceiling, looking down) and the tags are on the rover, in base_link: ``tags_on: rover``.
    """

    frame: str = Field(default="map", min_length=1, max_length=64)
    tags_on: Literal["ground", "rover"] = "ground"
    tags: tuple[Tag, ...] = Field(min_length=1, max_length=200)

    @model_validator(mode="after")
    def _no_id_twice(self) -> Self:
        twice = [tag for tag, count in Counter(tag.id for tag in self.tags).items() if count > 1]
        if twice:
            raise ValueError(f"tags with the same id: {', '.join(map(str, twice))}")
        return self


class Intrinsics(StrictModel):
    """A camera's picture: its size in pixels, and OpenCV's camera matrix and distortion (plumb bob)."""

    width: int = Field(ge=16, le=20_000)
    height: int = Field(ge=16, le=20_000)
    fx: float = Field(gt=0)
    fy: float = Field(gt=0)
    cx: float
    cy: float
    distortion: tuple[float, ...] = Field(default=(0.0,) * 5, min_length=4, max_length=8)

    @property
    def matrix(self) -> Floats:
        """OpenCV's 3 × 3 camera matrix, pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def pixels(self, flat: Floats) -> Floats:
        """Return points (n × 2) in pixels, from focal lengths, without distortion."""
        found: Floats = flat @ self.matrix[:2, :2].T + self.matrix[:2, 2]
        return found


class CameraFile(StrictModel):
    """A camera: its intrinsics, and its mount on the rover (or in the map, for tags on the rover)."""

    intrinsics: Intrinsics
    mount: Mount
    delay_s: float = Field(
        default=0.0,
        ge=-2.0,
        le=2.0,
        description="s from exposure to a picture's stamp, or else to its arrival; < 0: its clock is behind",
    )


def load_camera_info(path: Path) -> Intrinsics:
    """Read intrinsics in the YAML of ROS's camera_calibration. Raises FileError and ConfigError."""
    data, source = read_yaml(read_text(path), str(path)), str(path)
    try:
        k = [float(value) for value in data["camera_matrix"]["data"]]
        model = data.get("distortion_model", "plumb_bob")
        distortion = [float(value) for value in data["distortion_coefficients"]["data"]]
        size = data["image_width"], data["image_height"]
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(
            source,
            [f"no camera_info ({error}): expected image_width, camera_matrix, distortion_coefficients"],
        ) from error
    return camera_info(size, k, model, distortion, source)


def camera_info(
    size: tuple[int, int], k: Sequence[float], model: str, distortion: Sequence[float], source: str
) -> Intrinsics:
    """Return intrinsics from fields of ROS's CameraInfo. Raises ConfigError."""
    if any(distortion) and model not in {"plumb_bob", "rational_polynomial"}:
        raise ConfigError(source, [f"distortion_model {model}: expected plumb_bob or rational_polynomial"])
    if len(k) != 9:
        raise ConfigError(source, [f"a camera matrix of {len(k)} numbers, expected 9"])
    named = {"width": size[0], "height": size[1], "fx": k[0], "cx": k[2], "fy": k[4], "cy": k[5]}
    given = {"distortion": tuple(distortion)} if len(distortion) else {}
    return validated(named | given, Intrinsics, source)
