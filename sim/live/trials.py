"""Random trials as real processes: mock, bridge and deploy, over TCP and Zenoh, in real time.

Each trial has a folder: ``course.yaml``, ``driver.yaml`` (all that the driver knows of the robot),
``run.mcap`` (with the true pose merged in) and ``log/``. The true pose is judged.
"""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from deploy.report.recorded_drive import read_drive
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.files import USUAL_ROBOT, write_atomic
from rover_ncp.recording.recording import read_recording, rewrite
from sim.evaluate.commands import EvalOptions
from sim.live.live_run import LiveRun
from sim.live.peers import StartPosePublisher
from sim.live.processes import ProcessError, uninterrupted
from sim.live.truth import during, judge_truth, recorded_truth
from sim.stack.trials import Driven, Stack

_EXTRA_S = 180.0
"""For a driver to start, on a machine that does other things too, and to stand for a moment."""
_DROVE = {0, 1, 4}
"""Exit codes of a driver that drove, well or not."""


def trial_folder(out: Path, number: int) -> Path:
    """Return the folder of a trial."""
    return out / f"{number:03}"


def drive_live(
    stack: Stack, options: EvalOptions, count: int, on_done: Callable[[], None] = lambda: None
) -> list[Driven]:
    """Drive trials 0 to ``count`` − 1, ``options.processes`` at once. Raises RoverNcpError."""
    found: list[Driven] = []
    at_once = options.processes or 1
    for first in range(0, count, at_once):
        with ExitStack() as running:
            wave = [
                _LiveTrial(stack, options, number) for number in range(first, min(first + at_once, count))
            ]
            for trial in wave:
                running.push(trial)  # before it starts anything: an interruption at any time ends it
                trial.start()
            for trial in wave:
                trial.start_driver()
            for trial in wave:
                found.append(trial.finish())
                on_done()
    return found


class _LiveTrial(LiveRun):
    """The processes of one trial, and the external localisation of its start pose."""

    def __init__(self, stack: Stack, options: EvalOptions, number: int) -> None:
        self._out, self._stack, self._number = trial_folder(options.folder, number), stack, number
        self._policy, self._course_file = options.policy, str(self._out / "course.yaml")
        self._localiser = ExitStack()
        robot = ["--body", options.body.value, "--randomize", options.randomization or ""]
        robot += ["--trial", str(number), "--seed", str(options.seed)]
        robot += ["--gyro"] if stack.gyro else []
        if options.profile is not None:
            robot += ["--profile", str(options.profile)]
        super().__init__(
            self._out / "log", mock=["--model", USUAL_ROBOT, "--course", self._course_file, *robot]
        )

    def start(self) -> None:
        """Write the trial's files, and start mock and bridge."""
        course, known = self._stack.course(self._number), self._stack.known
        write_atomic(self._out / "course.yaml", dump_yaml(course.model_dump(mode="json")))
        driver = known.model_dump(mode="json", exclude_none=True)
        write_atomic(self._out / "driver.yaml", dump_yaml(driver))
        super().start()

    def start_driver(self) -> None:
        """Publish the rover's start pose, and start the driver."""
        start = self._stack.drawn(self._number).rover.pose
        with uninterrupted():
            self._localiser.enter_context(StartPosePublisher(self.robot, start))
        self._driver = self.deploy(
            *("--policy", self._policy, "--course", self._course_file),
            *("--profile", str(self._out / "driver.yaml"), "--pose", "required"),
            *("--record", str(self._out / "run.mcap")),
        )

    def finish(self) -> Driven:
        """Wait for the driver's end, and score the trial."""
        course, path = self._stack.course(self._number), self._out / "run.mcap"
        done = self._driver.wait(course.horizon_s + _EXTRA_S)
        self._localiser.close()
        bridge = self.bridge.stop().result
        self.mock.stop()
        if done.code not in _DROVE or not done.result:
            raise ProcessError("deploy", done.code, done.last_line)
        truth = self.truth.read()
        rewrite(read_recording(path), path, recorded_truth(truth))
        began_ns = read_drive(path).timeline.ticks[0].wall_ns
        verdict = judge_truth(course, truth, began_ns).with_contact(done.result["contact"] or "")
        rule = done.result["stopped_by"]
        return Driven(
            verdict.parked and rule is None,
            f"stopped by {rule}" if rule else verdict.failure,
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
        with uninterrupted(), ExitStack() as ending:
            ending.callback(super().close)
            ending.callback(self._localiser.close)
