"""A course made from poses, or from a drive that was recorded.

The first pose becomes the origin. A drive at six tenths of the motors' limits meets the deadlines; they are
later where that is still too fast. The pace of a recording has no effect.
"""

import csv
import math
import re
import reprlib
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

from pydantic import Field

from rover_ncp.core.config import StrictModel, dump_yaml, load_yaml, validated
from rover_ncp.core.errors import ConfigError, FileError, FormatError
from rover_ncp.core.files import existing_file, read_text
from rover_ncp.core.geometry import Pose, distance, relative, wrap_angle
from rover_ncp.course.course import (
    MAX_CHECKPOINTS,
    OMEGA_MAX,
    TICK_S,
    V_MAX,
    Angle,
    Coordinate,
    Course,
    Obstacle,
)
from rover_ncp.course.feasibility import Cause, Drivability, check_course
from rover_ncp.course.reference import planning_notice
from rover_ncp.recording.recording import Recording, read_recording
from rover_ncp.wire.messages import (
    ODOMETRY,
    POSE_STAMPED,
    POSE_WITH_COVARIANCE,
    read_odometry,
    read_pose,
    read_pose_stamped,
)

EASE = 0.6
"""Speed of a drive that meets the deadlines, as a share of the motors' limits."""
SLOWER, SLOWER_MAX = 1.3, 4
"""Factor by which deadlines are stretched, and how often at most, while the course is too fast."""
START_S, JOIN_S, REST_S = 3.0, 2.0, 8.0
"""Times in s: start signal; starting and stopping; rest at the end."""
NOT_SOLVED_BY_TIME = frozenset({Cause.SIDEWAYS, Cause.OBSTACLE})
STEP_M, STEP_RAD = 0.10, 0.20
"""Distance and turn between the checkpoints of a recorded drive."""
MOVED_M, MOVED_RAD = 0.01, 0.02
"""Smaller motion counts as standing."""
_DECIMALS = 4
_NUMBER = re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*", re.ASCII)
_EMPTY = ' \t\r\n,;"'
_SEPARATOR = re.compile(r'"?sep=([,;|\t])', re.IGNORECASE)
"""What Excel may write before the header."""
_READERS: dict[str, Callable[[bytes], Pose]] = {
    ODOMETRY: lambda data: read_odometry(data).pose,
    POSE_WITH_COVARIANCE: lambda data: read_pose(data).pose,
    POSE_STAMPED: read_pose_stamped,
}
"""By type; the first one of a recording is used."""
_SHORT = reprlib.Repr()
_SHORT.maxstring = 60

MAX_POSES = MAX_CHECKPOINTS - 2
"""A course has one checkpoint more before and after the poses."""


class CoursePose(StrictModel):
    """A pose to drive through: m and rad."""

    x: Coordinate
    y: Coordinate
    theta: Angle


class PoseList(StrictModel):
    """The YAML file that `make_course` takes; obstacles are in the same frame as the poses."""

    poses: tuple[CoursePose, ...] = Field(min_length=2, max_length=MAX_POSES)
    obstacles: tuple[Obstacle, ...] = Field(default=(), max_length=MAX_CHECKPOINTS)


def read_poses(path: Path) -> PoseList:
    """Read YAML, CSV (header x, y, theta; commas, semicolons or tabs) or a recording (MCAP).

    Raises FileError and ConfigError.
    """
    match existing_file(path).suffix.lower():
        case ".yaml" | ".yml":
            return load_yaml(path, PoseList)
        case ".csv":
            return _from_csv(path)
        case ".mcap":
            return _listed(path, _thinned(_driven(read_recording(path, topics=(), types=_READERS))))
    raise FileError(f"{path}: expected poses as .yaml or .csv, or a recording as .mcap")


def make_course(
    name: str, source: str, places: PoseList, say: Callable[[str], None] = lambda notice: None
) -> tuple[Course, Drivability]:
    """Return a course through poses, with deadlines that can be met if possible, and its feasibility.

    ``say`` gets a notice before a long planning. Raises ConfigError for a course that exceeds a limit.
    """
    first = _pose(places.poses[0])
    poses = [relative(first, _pose(place)) for place in places.poses]
    # Validated with the course: from the first pose, they may lie too far away.
    obstacles = [_moved(obstacle, first).model_dump() for obstacle in places.obstacles]
    stretch, made = 1.0, None
    for _ in range(SLOWER_MAX):
        checkpoints = _checkpoints(poses, stretch)
        fields = {
            "name": name,
            "description": f"Made from {source}.",
            "start_signal_s": START_S,
            "checkpoints": checkpoints,
            "horizon_s": checkpoints[-1]["t"],
            "obstacles": obstacles,
        }
        try:
            course = validated(fields, Course, source)  # it may last too long, or lead too far away
            course.require_plannable(source)
        except ConfigError:
            if made is None:
                raise
            break  # the faster course shows why it cannot be driven
        say(planning_notice(course))
        found = check_course(course)
        made = course, found
        # Slowing down does not make a sideways step drivable; stop trying.
        if found.drivable or any(problem.cause in NOT_SOLVED_BY_TIME for problem in found.problems):
            break
        stretch *= SLOWER
    assert made is not None
    return made


def course_yaml(course: Course) -> str:
    """Return a course as its file."""
    return dump_yaml(course.model_dump(mode="json"))


def _checkpoints(poses: Sequence[Pose], stretch: float) -> list[dict[str, float]]:
    found = [_checkpoint(0.0, poses[0]), _checkpoint(START_S, poses[0])]
    t = START_S
    last = len(poses) - 1
    for number, (a, b) in enumerate(pairwise(poses), 1):
        join = JOIN_S * ((number == 1) + (number == last))
        t += stretch * (_seconds(a, b) + join)
        t = math.ceil(t / TICK_S - 1e-9) * TICK_S
        found.append(_checkpoint(t, b))
    return [*found, _checkpoint(math.ceil(t + REST_S), poses[-1])]


def _seconds(a: Pose, b: Pose) -> float:
    turn = abs(wrap_angle(b.theta - a.theta))
    half = 0.5 * turn
    # An arc is longer than its chord; no arc turns by more than half a turn between two poses.
    arc = distance(a, b) * (half / math.sin(half) if half > 1e-6 else 1.0)
    return max(arc / (EASE * V_MAX), turn / (EASE * OMEGA_MAX), TICK_S)


def _checkpoint(t: float, pose: Pose) -> dict[str, float]:
    """Return the keys of a checkpoint, which the course validates."""
    rounded = Pose(*(round(number, _DECIMALS) + 0.0 for number in pose))
    return {"t": round(t, 1), **rounded._asdict()}


def _from_csv(path: Path) -> PoseList:
    lines = read_text(path).splitlines(keepends=True)
    begin = next((number for number, line in enumerate(lines) if line.strip(_EMPTY)), len(lines))
    delimiter, named = ",", _SEPARATOR.match(lines[begin]) if begin < len(lines) else None
    if named:
        delimiter, begin = named[1], begin + 1
    elif begin < len(lines) and "," not in lines[begin]:
        delimiter = next((each for each in ";\t" if each in lines[begin]), ",")
    reader = csv.reader(lines[begin:], delimiter=delimiter, skipinitialspace=True)
    try:
        header = [name.strip() for name in next(reader, [])]
        names = [name.lower() for name in header]
        if missing := [name for name in Pose._fields if name not in names]:
            raise FileError(
                f"{path}: its first line lacks {', '.join(missing)} (expected x, y, theta, "
                f"got {_SHORT.repr(', '.join(header))})"
            )
        columns = [names.index(name) for name in Pose._fields]
        rows = []
        for row in reader:
            where = f"{path}: line {begin + reader.line_num}"
            if any(map(str.strip, row[len(names) :])):  # as with decimal commas between commas
                raise FileError(f"{where}: {len(row)} values, but the first line has {len(names)} names")
            if any(map(str.strip, row)):
                rows.append((where, [row[n] if n < len(row) else "" for n in columns]))
    except csv.Error as error:
        raise FileError(f"{path}: line {begin + reader.line_num}: no CSV: {error}") from error
    comma = delimiter != "," and not any("." in cell for _, cells in rows for cell in cells)
    places = [_numbers(cells, where, comma) for where, cells in rows]
    if len(places) < 2:
        raise FileError(f"{path}: a course needs two poses at least, got {len(places)}")
    return _listed(path, places)


def _numbers(cells: Sequence[str], where: str, comma: bool) -> tuple[float, float, float]:
    """Return a pose. Raises FileError for cells that are not three numbers, with a comma if ``comma``."""
    plain = [cell.replace(",", ".") for cell in cells] if comma else cells
    if not all(map(_NUMBER.fullmatch, plain)):
        found = _SHORT.repr(", ".join(cells))
        raise FileError(
            f"{where}: expected three numbers, with a decimal point or, in a file whose columns no comma "
            f"separates, all with a decimal comma; got {found}"
        )
    x, y, theta = map(float, plain)
    return x, y, theta


def _listed(path: Path, poses: Sequence[tuple[float, float, float]]) -> PoseList:
    """Return poses that were not read from YAML, by the same rules. Raises ConfigError."""
    data = [dict(zip(Pose._fields, pose, strict=True)) for pose in poses]
    return validated({"poses": data}, PoseList, str(path))


def _driven(recording: Recording) -> list[Pose]:
    """Return the recorded poses: the driver's estimates, or without any those of odometry or a localiser.

    Topics of other recorders are found by their type. Raises FileError for none, and for several of a type.
    """
    found: dict[str, dict[str, list[Pose]]] = {kind: {} for kind in ("rover/estimate", *_READERS)}
    for message in recording.messages:
        read = _READERS.get(message.type)
        if read is None:
            continue
        try:
            pose = read(message.data)
        except FormatError:
            continue
        if all(map(math.isfinite, pose)):
            kind = message.topic if message.topic in found else message.type
            found[kind].setdefault(message.topic, []).append(pose)
    for kind, topics in found.items():
        own = [name for name in topics if name.rsplit("/", 1)[-1] == "odom"]
        names = own if len(own) == 1 else sorted(topics)
        if len(names) > 1:
            listed = ", ".join(names)
            raise FileError(
                f"{recording.path}: holds several topics of {kind} ({listed}); record one of them"
            )
        if names:
            return topics[names[0]]
    kinds = ", ".join(_READERS)
    raise FileError(f"{recording.path}: holds no poses: neither rover/estimate nor a topic of {kinds}")


def _thinned(poses: Sequence[Pose]) -> list[Pose]:
    """Return the poses a step apart, and those where the rover changes between forward and backward."""
    kept, newest, ahead = [poses[0]], poses[0], 0.0
    for pose in poses[1:]:
        way = relative(newest, pose)
        if math.hypot(way.x, way.y) < MOVED_M and abs(way.theta) < MOVED_RAD:
            continue
        if way.x * ahead < 0 and newest is not kept[-1]:
            kept.append(newest)
        newest, ahead = pose, way.x or ahead
        step = relative(kept[-1], pose)
        if math.hypot(step.x, step.y) >= STEP_M or abs(step.theta) >= STEP_RAD:
            kept.append(pose)
    if newest is not kept[-1]:
        kept.append(newest)
    if len(kept) < 2:
        raise FileError("the recorded rover did not move")
    return kept


def _pose(place: CoursePose) -> Pose:
    return Pose(place.x, place.y, place.theta)


def _moved(obstacle: Obstacle, first: Pose) -> Obstacle:
    x, y, theta = relative(first, Pose(obstacle.x, obstacle.y, obstacle.theta))
    return obstacle.model_copy(update={"x": x, "y": y, "theta": theta})
