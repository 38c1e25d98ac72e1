"""The main job in one go: train a circuit in simulation, then park a mock Pioneer with it as real processes.

The agents drive the course and the robot that are driven afterwards. Training ends with the first agent that
parks with half the tolerance to spare, as a reserve for what the simulator leaves out (encoder steps, the age
of a packet, the estimate), or after `AGENTS`, however slow the machine is. Then mock Pioneer, bridge and
deploy run as three processes over TCP and Zenoh, and the true pose is judged, which the driver does not know.
"""

import shutil
from pathlib import Path

from pydantic import BaseModel, Field

from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.circuit.rover_interface import RoverInterface
from rover_ncp.core.console import Output, progress, reject
from rover_ncp.core.errors import FileError
from rover_ncp.core.files import DEFAULT_ROBOT, require_writable, write_atomic
from rover_ncp.course.course import Course, load_course
from rover_ncp.course.pictures import drive_picture, render
from rover_ncp.course.shapes import outline_of
from rover_ncp.course.slowdown import slowed
from rover_ncp.robot.description import load_description
from sim.learn.ensemble import train
from sim.learn.rollout import rollout
from sim.learn.settings import TrainSettings, load_task
from sim.park.live import PIONEER, ROS2DDS, LiveRun
from sim.park.truth import TRUTH, add_truth, judge_truth
from sim.world.rover import RoverModel

ITERATIONS, AGENTS = 20_000, 12
TRACKING_POLICY = "course"
"""The policy for robots that training does not simulate: it was trained on random robots and courses."""
_MARGIN = 0.5
_BLOCK = 2
"""Agents that a process trains side by side: one of the first usually parks, which ends the training."""
_DEPLOY_EXTRA_S = 300.0
"""For the start of the driver on a slow and busy machine."""


class ParkTraining(BaseModel):
    """Result of the training within ``park``."""

    best_return: float = Field(description="of all agents")
    returns: list[float] = Field(description="of each agent")
    iterations: int = Field(description="of each agent")

    def __str__(self) -> str:
        return f"best return {self.best_return:.4f} of {len(self.returns)} agents"


class NotTrained(BaseModel):
    """Result of the command ``park`` when no agent parks in simulation."""

    parked: bool = Field(description="the verdict on the true pose")
    reason: str = Field(description="why it did not park, or empty")
    train: ParkTraining | None = Field(description="null with --policy")


class ParkResult(NotTrained):
    """Result of the command ``park`` after the drive."""

    true_error_m: float = Field(description="distance to the last checkpoint at the end")
    true_error_rad: float = Field(description="difference of its heading then")
    verdict: str | None = Field(description="the driver's, by its estimate: as deploy reports it")
    probability: float | None = Field(description="as deploy reports it")
    estimate_error_m: float | None = Field(description="as deploy reports it")
    estimate_error_rad: float | None = Field(description="as deploy reports it")
    ticks: int = Field(description="as deploy reports them")
    overruns: int = Field(description="as deploy reports them")
    recording: str = Field(description="with the true pose as truth/pose")
    picture: str = Field(description="of the true path")
    report: str = Field(description="the page of the drive")
    policy: str = Field(description="its name or file")
    pids: dict[str, int] = Field(description="process ids of mock, bridge and deploy")


_FROM_DEPLOY = ("verdict", "probability", "estimate_error_m", "estimate_error_rad", "ticks", "overruns")


def run_park(
    output: Output,
    *,
    policy: str | None,
    course: str,
    model: str,
    seed: int | None,
    out: Path,
    overwrite: bool,
) -> int:
    """Run ``park`` and return its exit code. Raises RoverNcpError when training or a process fails."""
    if policy is not None:
        reject("nothing is trained with --policy", seed=seed)
    robot = load_description(model)
    form = PIONEER if robot.arcos is not None else ROS2DDS
    if policy is None and form != PIONEER:
        reject(f"nothing is trained for a ROS 2 robot: policy {TRACKING_POLICY} parks {model}", seed=seed)
        policy = TRACKING_POLICY
    slow_course, pace = slowed(load_course(course), robot)
    for name in ("run.mcap", "trajectory.png", "run.html", f"log/{TRUTH}"):  # before a long training
        require_writable(out / name, overwrite=overwrite)
    training: ParkTraining | None = None
    if policy is None:
        folder = out / "train"
        training, policy, reason = _train(output, course, model, seed or 0, folder, overwrite=overwrite)
        if reason:
            output.result(
                NotTrained(parked=False, reason=f"no agent parks: {reason}", train=training),
                f"not parked: no agent parks in simulation: {reason} ({training}); try "
                f"another --seed, or a trained policy: --policy {TRACKING_POLICY}",
            )
            return 1
        output.say(f"{training}: it parks in simulation")
    RoverInterface(load_policy(policy))  # one that drives no rover is found before anything is started
    recording, picture, report = out / "run.mcap", out / "trajectory.png", out / "run.html"
    ros2 = [] if form == PIONEER else ["--ros2"]
    overwriting = ["--overwrite"] if overwrite else []
    run = LiveRun(
        out / "log",
        mock=["--course", course, "--model", model, *ros2, *overwriting],
        # The drive is the mock's first: nothing measured what it does without commands.
        bridge=["--model", model, "--no-base-watchdog"] if ros2 else [],
        base_form=form,
    )
    with run:
        output.say(pace)
        output.say(
            f"mock {model} and bridge are up ({run.robot}); "
            f"the circuit drives for {slow_course.horizon_s:.0f} s"
        )
        recording.unlink(missing_ok=True)
        described = ["--model", model] if model != DEFAULT_ROBOT else []
        driver = run.deploy("--policy", policy, "--course", course, "--record", str(recording), *described)
        done = run.finish(driver, slow_course.horizon_s + _DEPLOY_EXTRA_S)
    truth = run.truth.read()
    drive = add_truth(recording, truth, report)
    began_ns = drive.timeline.ticks[0].wall_ns
    true_path = [state.pose for state in truth if state.wall_ns >= began_ns]
    estimates = [tick.estimate.pose for tick in drive.timeline.ticks]
    write_atomic(picture, render(drive_picture(slow_course, true_path, estimates, outline_of(robot)), "png"))
    verdict = judge_truth(slow_course, truth, began_ns).with_contact(done.result["contact"] or "")
    result = ParkResult(
        parked=verdict.parked,
        reason=verdict.reason,
        train=training,
        true_error_m=verdict.error_m,
        true_error_rad=verdict.error_rad,
        **{name: done.result[name] for name in _FROM_DEPLOY},
        recording=str(recording),
        picture=str(picture),
        report=str(report),
        policy=policy,
        pids={process.command: process.pid for process in run.processes},
    )
    ending = "parked" if verdict.parked else f"not parked: {verdict.reason}"
    output.result(
        result,
        f"{ending}; true final errors {1000 * verdict.error_m:.0f} mm and "
        f"{1000 * verdict.error_rad:.0f} mrad; the driver's verdict: {result.verdict}\n"
        f"picture: {picture}\nrecording: {recording}\nreport: {report}",
    )
    return 0 if verdict.parked else 1


def _train(
    output: Output, course: str, model: str, seed: int, folder: Path, *, overwrite: bool
) -> tuple[ParkTraining, str, str]:
    """Train agents until one parks with room to spare, `AGENTS` at most.

    Returns the training, the policy's file, and the reason why its policy does not park, if it does not.
    """
    # The shipped settings name no robot for a 3-AT.
    described = None if model == DEFAULT_ROBOT else model
    settings = TrainSettings(course=course, model=described, seed=seed, agents=AGENTS, iterations=ITERATIONS)
    _clear(folder, overwrite=overwrite)
    output.say(f"training up to {AGENTS} agents until one parks in simulation")
    task = load_task(settings)
    with progress(AGENTS, "agents") as show:
        result = train(
            settings,
            folder,
            on_progress=lambda ensemble: show(len(ensemble.agents), ensemble),
            accept=lambda trained: _parks_well(trained, task.course, task.rover),
            block=_BLOCK,
        )
    training = ParkTraining(
        best_return=result.agents.best.value,
        returns=result.agents.returns,
        iterations=ITERATIONS,
    )
    return training, str(result.policy_path), result.verdict.reason


def _parks_well(policy: Policy, course: Course, rover: RoverModel) -> bool:
    """Return whether a policy parks in simulation with half the tolerance to spare."""
    verdict = rollout(policy, course, rover).verdict
    return (
        verdict.parked
        and verdict.error_m <= _MARGIN * course.parked.position_m
        and verdict.error_rad <= _MARGIN * course.parked.heading_rad
    )


def _clear(folder: Path, *, overwrite: bool) -> None:
    """Remove the training of an earlier run. Raises FileError for a folder that holds anything else."""
    if not folder.exists():
        return
    if not overwrite:
        raise FileError(f"{folder}: exists already; choose another --out, or add --overwrite")
    if not (folder / "settings.yaml").is_file() and any(folder.iterdir()):
        raise FileError(f"{folder}: is not empty and holds no training of an earlier park")
    shutil.rmtree(folder)
