"""Random trials as real processes: mock, bridge and deploy, over TCP and Zenoh, in real time.

Each trial has a folder: ``course.yaml``, ``driver.yaml`` (all that the driver knows of the robot),
``run.mcap`` (with the true pose merged in) and ``log/``. The true pose is judged.
"""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from rover_ncp.core.config import dump_yaml
from rover_ncp.core.files import write_atomic
from rover_ncp.core.geometry import Pose
from rover_ncp.core.recording import read_recording, rewrite
from sim.evaluate.evaluate import cause
from sim.live.live_run import LiveRun
from sim.live.peers import StartPosePublisher
from sim.live.processes import Process, ProcessError
from sim.live.truth import during, judge_truth, recorded_truth
from sim.park.park import estimated_path
from sim.stack.trials import MODEL, Driven, Stack

_EXTRA_S = 180.0
"""For a driver to start, on a machine that does other things too, and to stand for a moment."""
_DROVE = {0, 1, 4}
"""Exit codes of a driver that drove, well or not."""


@dataclass(frozen=True)
class LiveTrials:
    """Drives trials of a stack live; policy, ranges and profile as on the command line, for the processes."""

    stack: Stack
    policy: str
    randomize: str
    profile: Path | None
    out: Path

    def folder(self, number: int) -> Path:
        """Return the folder of a trial."""
        return self.out / f"{number:03}"

    def drive(self, count: int, at_once: int, on_done: Callable[[], None] = lambda: None) -> list[Driven]:
        """Drive trials 0 to ``count`` − 1, so many at once. Raises RoverNcpError when a process fails."""
        found: list[Driven] = []
        for first in range(0, count, at_once):
            with ExitStack() as running:
                wave = [
                    running.enter_context(_LiveTrial(self, number))
                    for number in range(first, min(first + at_once, count))
                ]
                for trial in wave:
                    trial.begin()
                for trial in wave:
                    found.append(trial.finish())
                    on_done()
        return found


class _LiveTrial(LiveRun):
    """The processes of one trial, and the external localisation of its start pose."""

    def __init__(self, trials: LiveTrials, number: int) -> None:
        self._trials, self._number = trials, number
        self._folder = trials.folder(number)
        self._course = trials.stack.course(number)
        write_atomic(self._folder / "course.yaml", dump_yaml(self._course.model_dump(mode="json")))
        driver = trials.stack.known.model_dump(mode="json", exclude_none=True)
        write_atomic(self._folder / "driver.yaml", dump_yaml(driver))
        robot = ["--randomize", trials.randomize, "--trial", str(number), "--seed", str(trials.stack.seed)]
        if trials.profile is not None:
            robot += ["--profile", str(trials.profile)]
        course = str(self._folder / "course.yaml")
        super().__init__(self._folder / "log", mock=["--model", MODEL, "--course", course, *robot])
        self._localiser = ExitStack()

    def begin(self) -> None:
        """Publish the rover's start pose, and start the driver."""
        start = Pose(*self._trials.stack.trials(self._number).start[0].tolist())
        self._localiser.enter_context(StartPosePublisher(self.robot, start))
        self._driver: Process = self.deploy(
            *("--policy", self._trials.policy, "--course", str(self._folder / "course.yaml")),
            *("--profile", str(self._folder / "driver.yaml"), "--pose", "required"),
            *("--record", str(self._folder / "run.mcap")),
        )

    def finish(self) -> Driven:
        """Wait for the driver's end, and score the trial."""
        course = self._course
        done = self._driver.wait(course.horizon_s + _EXTRA_S)
        self._localiser.close()
        bridge = self.bridge.stop().result
        self.mock.stop()
        if done.code not in _DROVE or not done.result:
            raise ProcessError("deploy", done.code, done.last_line)
        recording = read_recording(self._folder / "run.mcap")
        truth = self.truth.read()
        began_ns, _ = estimated_path(recording)
        rewrite(recording, recording.path, recorded_truth(truth))
        verdict = judge_truth(course, truth, began_ns)
        rule = done.result["stopped_by"]
        return Driven(
            verdict.parked and rule is None,
            f"stopped by {rule}" if rule else cause(verdict, course.parked),
            verdict.error_m,
            verdict.error_rad,
            during(course, truth, began_ns)[-1].pose,
            done.result["ticks"],
            done.result["overruns"],
            bridge["bytes_to_base"],
            bridge["bytes_from_base"],
        )

    def close(self) -> None:
        """End the localisation and all processes."""
        self._localiser.close()
        super().close()
