"""The median of external poses with their scatter: what makes a place, and what checks one."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel, Field

from deploy.drive.start import median_pose
from deploy.place.outcome import PoseErrors
from deploy.place.place import Place, PlacePose, Scatter, TagsAt, is_board
from rover_ncp.core.config import validated
from rover_ncp.core.errors import ConfigError, NoPose
from rover_ncp.core.geometry import Pose, same_frame, wrap_angle
from rover_ncp.wire.messages import PoseSample

MIN_POSES = 10


class Survey(NamedTuple):
    """What the external poses of some seconds say of a rover that stands."""

    frame: str
    pose: Pose
    scatter: Scatter


class PlaceResult(BaseModel):
    """What ``rover-ncp place`` prints."""

    place: str = Field(description="its name")
    file: str = Field(description="its file")
    frame: str = Field(description="frame_id of the external poses")
    x: float = Field(description="median of the poses now, m")
    y: float = Field(description="median of the poses now, m")
    theta: float = Field(description="median of the headings now, rad")
    scatter: Scatter = Field(description="standard deviations of the poses now")
    off: PoseErrors | None = Field(description="check: of the median from the place")
    fits: bool = Field(description="check: whether the median is within the place's tolerances")


def survey(samples: Sequence[PoseSample], seconds: float, unreadable: str = "") -> Survey:
    """Return the median of poses of one frame, with their scatter. Raises NoPose without enough of them."""
    finite = [sample for sample in samples if all(map(math.isfinite, sample.pose))]
    frames = sorted({sample.frame for sample in finite})
    if len(finite) < MIN_POSES or len(frames) != 1:
        words = f"{len(finite)} external poses arrived on 'pose' in {seconds:g} s (at least {MIN_POSES})"
        if len(frames) > 1:
            words = f"external poses arrived in the frames {', '.join(map(repr, frames))}, expected one frame"
        raise NoPose(words + (f"; {unreadable}" if unreadable else ""))
    poses = [sample.pose for sample in finite]
    median = median_pose(poses)
    errors = [(pose.x - median.x, pose.y - median.y, wrap_angle(pose.theta - median.theta)) for pose in poses]
    x_m, y_m, theta_rad = np.sqrt(np.mean(np.square(errors), axis=0)).tolist()
    return Survey(frames[0], median, Scatter(x_m=x_m, y_m=y_m, theta_rad=theta_rad, poses=len(poses)))


def set_place(fields: Mapping[str, Any], seen: Survey, source: str) -> Place:
    """Return the place of these fields where the rover was seen. Raises ConfigError for those of ``source``.

    A board is the origin of its frame. Obstacles that were given in another frame are an error, too: their
    poses in this one are not known.
    """
    before = fields.get("frame", seen.frame)
    if fields.get("obstacles") and not same_frame(before, seen.frame):
        raise ConfigError(
            source,
            [
                f"its obstacles are in frame {before!r}, and poses arrive in {seen.frame!r} now: take the "
                "obstacles out, set the place again, then give them in that frame"
            ],
        )
    stored = {"pose": PlacePose(**seen.pose._asdict()), "scatter": seen.scatter, "frame": seen.frame}
    if is_board(seen.frame):
        stored["tags"] = TagsAt(x=0.0, y=0.0)
    elif not same_frame(before, seen.frame):
        stored["tags"] = None
    return validated({**fields, **stored}, Place, source)


def complaint(place: Place, seen: Survey) -> str:
    """Return in words how a rover that should be docked is not at its place; "" if it is."""
    if not same_frame(seen.frame, place.frame):
        return f"poses arrive in frame {seen.frame!r}, the place is in {place.frame!r}"
    if place.holds(seen.pose):
        return ""
    return (
        f"the rover is seen {place.errors(seen.pose)} of the place (tolerance "
        f"{1000 * place.position_m:.0f} mm, {math.degrees(place.heading_rad):.1f}°): it is not docked, the "
        "dock was moved, or the calibration is stale; 'place set' stores what is seen now"
    )


def blurred(place: Place, scatter: Scatter) -> str:
    """Return a warning if single poses scatter by more than the tolerances; "" if not."""
    if math.hypot(scatter.x_m, scatter.y_m) <= place.position_m and scatter.theta_rad <= place.heading_rad:
        return ""
    return (
        f"warning: the poses scatter by {1000 * math.hypot(scatter.x_m, scatter.y_m):.0f} mm and "
        f"{math.degrees(scatter.theta_rad):.1f}°, more than the place's tolerances"
    )
