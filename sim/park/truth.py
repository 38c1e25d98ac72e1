"""The true motion of a simulated rover: read from the mock's file, judged, recorded. No driver knows it."""

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from deploy.view.page import drive_page
from deploy.view.recorded_drive import Drive, read_drive
from deploy.view.timeline import TRUTH_TOPIC
from rover_ncp.core.errors import FileError
from rover_ncp.core.files import write_atomic
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.course.course import TICK_S, Course
from rover_ncp.course.scoring import Verdict, judge
from rover_ncp.recording.recording import Recorded, read_recording, rewrite
from rover_ncp.wire.messages import pose_stamped
from sim.park.growing_file import GrowingFile

TRUTH = "truth.csv"
"""Name of the mock's file in the folder of a run."""
TRUTH_FRAME = "course"


class TrueState(NamedTuple):
    """The simulator's state of the rover, in the course's frame; both times in ns."""

    clock_ns: int
    """Simulation clock; a mock's follows the machine's monotonic clock."""
    wall_ns: int
    """Since the epoch."""
    pose: Pose
    velocity: Velocity
    contact: bool


class TruthReader:
    """Reads the file of ``mock --truth``, which a running mock goes on writing."""

    def __init__(self, path: Path) -> None:
        self._file = GrowingFile(path)
        self._columns: list[str] = []
        self._states: list[TrueState] = []

    def read(self) -> list[TrueState]:
        """Return all states so far."""
        for line in self._file.new_lines():
            values = line.split(",")
            if self._columns:
                self._states.append(_state(dict(zip(self._columns, values, strict=True))))
            else:
                self._columns = values
        return self._states


def _state(row: dict[str, str]) -> TrueState:
    x, y, theta, v, omega = (float(row[name]) for name in ("x", "y", "theta", "v", "omega"))
    return TrueState(
        int(row["clock_ns"]), int(row["t_ns"]), Pose(x, y, theta), Velocity(v, omega), row["contact"] != "0"
    )


def during(course: Course, states: Sequence[TrueState], began_ns: int) -> Sequence[TrueState]:
    """Return the states from a run's first tick, at the wall clock's ``began_ns``, to the course's horizon.

    Only the begin is of the wall clock, which may be set later. Raises FileError when there is none.
    """
    first = next((number for number, state in enumerate(states) if state.wall_ns >= began_ns), len(states))
    if first == len(states):
        raise FileError("the mock recorded no true pose during the drive: was the machine's clock set?")
    until_ns = states[first].clock_ns + round((course.horizon_s + TICK_S) * 1e9)
    return states[first : bisect_right(states, until_ns, key=lambda state: state.clock_ns)]


def judge_truth(course: Course, states: Sequence[TrueState], began_ns: int) -> Verdict:
    """Judge a run by its true poses; arguments and errors as `during`."""
    run = during(course, states, began_ns)
    first = run[0]
    lag_ns = first.wall_ns - began_ns
    return judge(
        course,
        [(state.clock_ns - first.clock_ns + lag_ns) * 1e-9 for state in run],
        [state.pose for state in run],
        any(state.contact for state in run),
    )


def recorded_truth(states: Sequence[TrueState]) -> Iterator[Recorded]:
    """Return the truth as messages to merge into a recording, by a clock that was never set."""
    for number, state in enumerate(states):
        data = pose_stamped(state.pose, state.wall_ns, TRUTH_FRAME)
        log_ns = states[0].wall_ns + state.clock_ns - states[0].clock_ns
        yield Recorded(TRUTH_TOPIC, "geometry_msgs/msg/PoseStamped", data, log_ns, state.wall_ns, number)


def add_truth(recording: Path, states: Sequence[TrueState], page: Path) -> Drive:
    """Merge the truth into a recording, write its page, and return its drive."""
    rewrite(read_recording(recording), recording, recorded_truth(states))
    drive = read_drive(recording)
    write_atomic(page, drive_page(drive))
    return drive
