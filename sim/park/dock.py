"""Docking in one go: a mock with a camera, ``up`` with bridge and localiser, and a driver, as real processes.

Something blocks the wheels once during the first approach, so that a retry is seen.
"""

import math
import shutil
from pathlib import Path

from pydantic import BaseModel, Field

from deploy.place.outcome import PoseErrors
from deploy.place.place import load_place
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.console import Output
from rover_ncp.core.files import read_bytes, require_writable, resolve, write_atomic
from rover_ncp.core.geometry import Pose
from sim.mock.ros2_server import free_port
from sim.park.live import LiveRun, Process, wait_for
from sim.park.truth import TRUTH, add_truth

APPROACH_S, DOCK_S = 120.0, 300.0
"""Longest times until the first approach, and until the end."""
BLOCKED = "stall@0-1"
BLOCKED_AT_M = 0.45
"""Distance from the place at which the wheels are blocked: on the approach, which begins at 0.7 m."""


class DockedResult(BaseModel):
    """Result of the command ``park --dock``."""

    docked: bool = Field(description="the verdict on the true pose, by the place's tolerances")
    driver: str = Field(description="the driver's own words")
    tries: int = Field(description="approaches that were driven")
    true_errors: PoseErrors = Field(description="of the true pose at the end")
    poses: int = Field(description="of the tags that the driver received")
    recording: str = Field(description="with the true pose as truth/pose")
    report: str = Field(description="the page of the drive")
    view: str = Field(description="what the camera saw last, its tags outlined")


def run_dock(output: Output, out: Path, *, overwrite: bool) -> int:
    """Run ``park --dock`` and return its exit code. Raises RoverNcpError when a process fails."""
    for name in ("run.mcap", "view.jpg", "run.html", "robot.yaml", f"log/{TRUTH}"):
        require_writable(out / name, overwrite=overwrite)
    files = {name: out / f"{name}.yaml" for name in ("camera", "tags", "place")}
    for name, path in files.items():  # the files of an earlier, failed run are the same
        same = path.is_file() and read_bytes(path) == read_bytes(resolve("dock", name))
        require_writable(path, overwrite=overwrite or same)
    out.mkdir(parents=True, exist_ok=True)
    for name, path in files.items():
        shutil.copyfile(resolve("dock", name), path)
    place = load_place(str(files["place"]))
    recording, view, report = out / "run.mcap", out / "view.jpg", out / "run.html"
    overwriting = ["--overwrite"] if overwrite else []
    seen = ["--camera", str(files["camera"]), "--tags", str(files["tags"]), "--camera-listen", "127.0.0.1:0"]
    with _UpRun(out / "log", mock=[*seen, *overwriting]) as run:
        output.say(
            f"mock and 'rover-ncp up' with {run.file}: bridge and localiser; policy course drives to the "
            "staging pose, policy dock from there to the place"
        )
        recording.unlink(missing_ok=True)
        driver = run.deploy("--to", "place", "--record", str(recording), robot=str(run.file))
        wait_for(lambda: _near(run, place.goal) or not driver.running, APPROACH_S, "the approach")
        if driver.running:
            output.say("the first approach is blocked on purpose")
            run.mock.tell(BLOCKED)
        driver.wait(DOCK_S)
        done = run.finish(driver, DOCK_S)
    truth = run.truth.read()
    add_truth(recording, truth, report)
    within = place.holds(truth[-1].pose)
    dock = done.result["dock"]
    result = DockedResult(
        docked=within,
        driver=dock["error_msg"] or "docked",
        tries=dock["num_retries"] + 1,
        true_errors=place.errors(truth[-1].pose),
        poses=done.result["pose"]["taken"],
        recording=str(recording),
        report=str(report),
        view=str(view),
    )
    words = "docked" if within else "not docked"
    output.result(
        result,
        f"{words} after {result.tries} tries; true errors {result.true_errors}; the driver says: "
        f"{result.driver}\nreport: {report}\nwhat the camera saw: {view}\nrecording: {recording}",
    )
    return 0 if within and dock["success"] else 1


class _UpRun(LiveRun):
    """A mock with a camera, and ``up`` in the place of the bridge, with the file of the robot."""

    def start_bridge(self) -> None:
        """Write the file beside the folder of the logs, and start ``up``."""
        self.file = self.folder.parent / "robot.yaml"
        camera = {
            "source": self.mock.wait_for_line("camera at "),
            "file": "camera.yaml",
            "picture": "view.jpg",
        }
        settings = {
            "base": self._base_form.format(self.base),
            "bridge": f"tcp/127.0.0.1:{free_port('127.0.0.1')}",
            "camera": camera,
            "tags": "tags.yaml",
            "places": ".",
            "page": None,
        }
        write_atomic(self.file, dump_yaml(settings))
        arguments = ["--robot", str(self.file), "--logs", str(self.folder)]
        self.bridge = self.start_process(lambda: Process("up", arguments, self.folder))
        self.bridge.wait_for_line("localiser localising")


def _near(run: LiveRun, goal: Pose) -> bool:
    """Return whether the rover is on its approach."""
    states = run.truth.read()
    return bool(states) and math.dist(states[-1].pose[:2], goal[:2]) < BLOCKED_AT_M
