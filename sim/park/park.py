"""The main job in one go: train a circuit in simulation, then park a robot with it through everything real.

Training ends when the best agent parks with half the tolerance to spare, so that what the simulator does not
know (encoder steps, the age of a packet, the estimate) has room. Then mock Pioneer, bridge and deploy run as
three processes over TCP and Zenoh, and the true pose, which none of those who drive can see, is judged.
"""

import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deploy.drive_records import TICKS_TOPIC, TickRecord
from deploy.report.page.page import drive_page
from deploy.report.recorded_drive import read_drive
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.errors import FileError, FormatError
from rover_ncp.core.files import require_creatable, write_atomic
from rover_ncp.core.geometry import Pose
from rover_ncp.core.messages import read_text
from rover_ncp.core.recording import Recording, read_recording, rewrite
from rover_ncp.course.course import Course, Verdict, load_course
from sim.learn.ensemble import Snapshot
from sim.learn.record import TrainSettings
from sim.learn.rollout import rollout
from sim.learn.train import TrainResult, train
from sim.live.live_run import LiveRun
from sim.live.processes import ProcessError
from sim.live.truth import TRUTH, judge_truth, recorded_truth
from sim.park.picture import trajectory_png

TRAIN_LIMIT_S = 100.0
"""How long the search may take to find a circuit that parks in simulation."""
PARK_ITERATIONS = 20_000
RECORDING, LOG = "run.mcap", "log"
_AGENTS = 12
_MARGIN = 0.5
_DEPLOY_EXTRA_S = 60.0


@dataclass(frozen=True)
class Parked:
    """Report of ``rover-ncp park``; errors are to the last checkpoint, in m and rad."""

    verdict: Verdict
    estimate: dict[str, Any]
    pids: dict[str, int]
    bridge: dict[str, Any]
    recording: Path
    picture: Path
    report: Path
    """The page that shows the drive."""


def train_until_parked(
    course: str,
    seed: int,
    folder: Path,
    on_progress: Callable[[Snapshot], None],
    limit_s: float = TRAIN_LIMIT_S,
) -> TrainResult:
    """Train until the best agent parks with room to spare, or ``limit_s`` has passed."""
    deadline = time.monotonic() + limit_s
    known = load_course(course)
    return train(
        TrainSettings(course=course, seed=seed, agents=_AGENTS, iterations=PARK_ITERATIONS),
        folder,
        on_progress=on_progress,
        stop_when=lambda snapshot, best: parks_well(best, known) or time.monotonic() > deadline,
    )


def parks_well(policy: Policy, course: Course) -> bool:
    """Whether a policy parks in simulation with half the tolerance to spare."""
    verdict = rollout(policy, course).verdict
    return (
        verdict.parked
        and verdict.error_m <= _MARGIN * course.parked.position_m
        and verdict.error_rad <= _MARGIN * course.parked.heading_rad
    )


def require_free(out: Path, *, overwrite: bool) -> None:
    """Raise FileError if `park` could not leave its files in a folder, for use before a long training."""
    for name in (RECORDING, f"{LOG}/{TRUTH}"):
        require_creatable(out / name, overwrite=overwrite)


def park(
    policy: str, course_name: str, out: Path, say: Callable[[str], None], *, overwrite: bool = False
) -> Parked:
    """Park a mock Pioneer with a policy, through real processes. Raises RoverNcpError when one fails."""
    require_free(out, overwrite=overwrite)
    insist = ["--overwrite"] if overwrite else []
    course = load_course(course_name)
    load_policy(policy)  # a bad file is found before anything is started
    recording = out / RECORDING
    with LiveRun(out / LOG, mock=["--course", course_name, *insist]) as run:
        say(f"mock Pioneer and bridge are up ({run.robot}); the circuit drives for {course.horizon_s:.0f} s")
        driver = run.deploy("--policy", policy, "--course", course_name, "--record", str(recording), *insist)
        try:
            done = driver.wait(course.horizon_s + _DEPLOY_EXTRA_S)
        except KeyboardInterrupt:
            driver.send_signal(signal.SIGINT)
            driver.wait(_DEPLOY_EXTRA_S)
            raise
        pids = {process.command: process.pid for process in run.processes}
        bridge = run.bridge.stop()
        run.mock.stop()
    if done.code not in (0, 1) or not done.result:
        raise ProcessError("deploy", done.code, done.last_line)
    recorded = read_recording(recording)
    truth = run.truth.read()
    began_ns, estimates = estimated_path(recorded)
    rewrite(recorded, recording, recorded_truth(truth))
    picture = out / "trajectory.png"
    write_atomic(
        picture,
        trajectory_png(course, [state.pose for state in truth if state.wall_ns >= began_ns], estimates),
    )
    report = out / "run.html"
    write_atomic(report, drive_page(read_drive(recording)))
    return Parked(
        verdict=judge_truth(course, truth, began_ns),
        estimate=done.result,
        pids=pids,
        bridge=bridge.result,
        recording=recording,
        picture=picture,
        report=report,
    )


def estimated_path(recording: Recording) -> tuple[int, list[Pose]]:
    """Return when the drive began (ns since the epoch) and the estimated pose of each tick."""
    ticks = recording.topic(TICKS_TOPIC)
    if not ticks:
        raise FileError(f"{recording.path}: holds no tick of a drive")
    try:
        records = [TickRecord.model_validate_json(read_text(tick.data)) for tick in ticks]
    except ValueError as error:
        raise FormatError(f"{recording.path}: damaged tick: {error}") from error
    return records[0].wall_ns, [Pose(*record.estimate[:3]) for record in records]
