"""The true pose, for scoring only: the mock writes it, and no driver reads it."""

import csv
from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from rover_ncp.core.errors import FileError
from rover_ncp.core.geometry import Pose
from rover_ncp.core.messages import pose_stamped
from rover_ncp.core.recording import Recorded
from rover_ncp.course.course import TICK_S, Course, Verdict

TRUTH_TOPIC = "truth/pose"
TRUTH_FRAME = "course"


class TrueState(NamedTuple):
    """The rover as the simulator knows it, at ``wall_ns`` (ns since the epoch), in the course's frame."""

    wall_ns: int
    pose: Pose
    contact: bool


def read_truth(path: Path) -> list[TrueState]:
    """Read what ``mock --truth`` wrote; a last line cut off by a kill is left out. Raises FileError."""
    try:
        with path.open(newline="") as file:
            return list(_states(csv.DictReader(file)))
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"{path}: cannot be read: {error}") from error
    except (KeyError, ValueError) as error:
        raise FileError(f"{path}: not a truth file: {error}") from error


def _states(rows: Iterator[dict[str, str | None]]) -> Iterator[TrueState]:
    for row in rows:
        if None in row.values():
            return
        text = {name: value or "" for name, value in row.items()}
        yield TrueState(
            int(text["t_ns"]),
            Pose(float(text["x"]), float(text["y"]), float(text["theta"])),
            text["contact"] != "0",
        )


def judge_truth(course: Course, states: list[TrueState], began_ns: int) -> Verdict:
    """Judge a run by the true poses from its first tick, at ``began_ns``, to the course's horizon."""
    run = during(course, states, began_ns)
    return course.judge(
        [(state.wall_ns - began_ns) * 1e-9 for state in run],
        [state.pose for state in run],
        any(state.contact for state in run),
    )


def during(course: Course, states: list[TrueState], began_ns: int) -> list[TrueState]:
    """Return the states from a run's first tick to the course's horizon; at least one. Raises FileError."""
    until_ns = began_ns + round((course.horizon_s + TICK_S) * 1e9)
    moments = [state.wall_ns for state in states]
    run = states[bisect_left(moments, began_ns) : bisect_right(moments, until_ns)]
    if not run:
        raise FileError("the truth holds nothing of the run: was the mock's clock changed?")
    return run


def recorded_truth(states: list[TrueState]) -> Iterator[Recorded]:
    """Return the truth as messages to merge into a recording."""
    for number, state in enumerate(states):
        data = pose_stamped(state.pose, state.wall_ns, TRUTH_FRAME)
        yield Recorded(
            TRUTH_TOPIC, "geometry_msgs/msg/PoseStamped", data, state.wall_ns, state.wall_ns, number
        )
