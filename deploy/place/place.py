"""The file of a place, in the frame of the external poses."""

import math
import re
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from deploy.place.outcome import PoseErrors
from rover_ncp.core.config import StrictModel, load_yaml
from rover_ncp.core.geometry import Pose, compose, relative, turned
from rover_ncp.course.course import FAR_M, Angle, Name, Obstacle

SUFFIXES = {".yaml", ".yml"}
MAX_OBSTACLES = 100
AT_PLACE_M = 0.05
"""How far from a place, along its heading, a rover may be that counts as standing in it."""


BOARD = re.compile(r"board-(\d{1,3})-(a4|a3|letter)")
"""Name of a board, `deploy.tag.board`: its number and its page."""


class Proof(StrEnum):
    """What proves that the rover is docked."""

    POSE = "pose"
    """The estimate is within the tolerances with a probability of 95 %."""
    CHARGING = "charging"
    """The base reports that its battery is charging."""
    TOPIC = "topic"
    """A topic of a ROS 2 robot, `topics.docked` of its description, says that it is docked."""


PlaceCoordinate = Annotated[float, Field(ge=10.0 - FAR_M, le=FAR_M - 10.0)]
"""In m: 10 m less than `Coordinate`, for the ways there."""


class PlacePose(StrictModel):
    """Pose of the docked base (base_link)."""

    x: PlaceCoordinate
    y: PlaceCoordinate
    theta: Angle


class TagsAt(StrictModel):
    """Where the tags are that show the rover in its place."""

    x: PlaceCoordinate
    y: PlaceCoordinate


class Scatter(StrictModel):
    """Standard deviations of the poses of which 'place set' took the median, and their number."""

    x_m: float = Field(ge=0, description="standard deviation")
    y_m: float = Field(ge=0, description="standard deviation")
    theta_rad: float = Field(ge=0, description="standard deviation")
    poses: int = Field(ge=1, description="how many there were")


class Place(StrictModel):
    """A place in which the rover parks, such as its charger."""

    format: int = Field(default=1, ge=1, le=1)
    name: Name
    frame: Annotated[str, Field(max_length=100)] = Field(
        default="map", description="frame_id of the external poses"
    )
    pose: PlacePose
    direction: Literal["forward", "backward"] = Field(
        default="forward", description="in which the rover drives in: forward or backward"
    )
    staging_m: float = Field(
        default=0.7, ge=0.3, le=2.0, description="m from the place, where the straight approach begins"
    )
    position_m: float = Field(default=0.02, gt=0, le=0.2, description="tolerance of the position, m")
    heading_rad: float = Field(default=0.035, gt=0, le=0.5, description="tolerance of the heading: 2°")
    proof: Proof = Field(default=Proof.POSE, description="what proves the docking: pose, charging or topic")
    retries: int = Field(default=3, ge=0, le=20, description="further tries after a miss")
    obstacles: tuple[Obstacle, ...] = Field(
        default=(), max_length=MAX_OBSTACLES, description="that the way there must not touch"
    )
    tags: TagsAt | None = Field(
        default=None, description="where the tags are, if known: the ways there keep them in view if they can"
    )
    scatter: Scatter | None = Field(default=None, description="of the poses that 'place set' saw")

    @property
    def goal(self) -> Pose:
        """The pose of the docked base."""
        return Pose(self.pose.x, self.pose.y, self.pose.theta)

    @property
    def backward(self) -> bool:
        """Whether the rover drives in backward."""
        return self.direction == "backward"

    @property
    def staging(self) -> Pose:
        """The pose of the base where the straight approach begins."""
        return compose(self.goal, Pose(self.staging_m if self.backward else -self.staging_m, 0.0, 0.0))

    def driven(self, heading_error_rad: float) -> "Place":
        """Return the place for a rover whose poses have a heading error: with the direction of travel."""
        if not heading_error_rad:
            return self
        theta = turned(self.goal, -heading_error_rad).theta
        return self.model_copy(update={"pose": self.pose.model_copy(update={"theta": theta})})

    def errors(self, pose: Pose) -> PoseErrors:
        """Return a pose minus that of the place."""
        found = relative(self.goal, pose)
        return PoseErrors(longitudinal_m=found.x, lateral_m=found.y, yaw_rad=found.theta)

    def out_m(self, pose: Pose) -> float:
        """Return how far a pose is from the place towards the staging pose, along the line between them."""
        ahead = self.errors(pose).longitudinal_m
        return ahead if self.backward else -ahead

    def holds(self, pose: Pose) -> bool:
        """Whether a pose is within the tolerances."""
        return self.allows(self.errors(pose))

    def allows(self, off: PoseErrors) -> bool:
        """Whether errors are within the tolerances."""
        away = math.hypot(off.longitudinal_m, off.lateral_m)
        return away <= self.position_m and abs(off.yaw_rad) <= self.heading_rad


def is_board(frame: str) -> bool:
    """Return whether a frame is that of a board, whose origin is the board's middle."""
    return BOARD.fullmatch(frame) is not None


def place_path(name: str, folder: Path = Path()) -> Path:
    """Return the file of a place: itself, or NAME.yaml in a folder."""
    path = Path(name)
    if path.suffix.lower() in SUFFIXES:
        return path
    return (folder if path.name == name else Path()) / path.with_name(f"{path.name}.yaml")


def load_place(name: str, folder: Path = Path()) -> Place:
    """Load a place by its name in a folder, or the path of its file. Raises FileError and ConfigError."""
    return load_yaml(place_path(name, folder), Place)
