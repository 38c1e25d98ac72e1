"""Commands of this package; heavy libraries load only when one runs."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from deploy.options import Namespace, Robot, ZenohConfig
from rover_ncp.core.console import Json, Output, Overwrite, printable, reject
from rover_ncp.core.errors import UsageError
from rover_ncp.core.files import DEFAULT_ROBOT


def deploy(
    *,
    robot: Robot,
    policy: Annotated[
        str, typer.Option(help="Policy by name, or by file (YAML, or a published .bnn circuit).")
    ] = "course",
    course: Annotated[
        str, typer.Option(help="Course by name or file: goal, start signal, time.")
    ] = "parking",
    model: Annotated[
        str | None,
        typer.Option(
            help="The robot's description, a name or a YAML file: the course takes longer for a slow robot, "
            "and the estimator expects its errors.",
            show_default="p3at-sh, as in the training",
        ),
    ] = None,
    record: Annotated[
        Path | None, typer.Option(help="Record the drive to this MCAP file; see 'rover-ncp replay'.")
    ] = None,
    overwrite: Overwrite = False,
    duration: Annotated[
        float | None,
        typer.Option(min=0.1, help="End after so many seconds, if the course would last longer."),
    ] = None,
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Dry run: send no commands and do not request the motors."),
    ] = False,
    pose: Annotated[
        Literal["auto", "required", "none"],
        typer.Option(
            help="External poses on the key 'pose': use them if they come, wait for them before the start, "
            "or ignore them."
        ),
    ] = "auto",
    require_accuracy: Annotated[
        float | None,
        typer.Option(
            min=0.001,
            help="Without external poses, do not drive if the predicted position error at the goal is more "
            "than so many metres (exit 4, accuracy).",
            show_default=False,
        ),
    ] = None,
    profile: Annotated[
        Path | None,
        typer.Option(
            help="The robot's profile, as 'identify' writes it: the drive compensates its gains and uses its "
            "odometry's noise.",
            show_default=False,
        ),
    ] = None,
    namespace: Namespace = "",
    zenoh_config: ZenohConfig = None,
    json: Json = False,
) -> int:
    """Let a circuit drive the robot behind a bridge.

    Waits for the bridge and for a rover that stands still. That place is the course's origin. Then it
    requests the motors and drives the course. If external poses arrive on 'pose' meanwhile, it starts from
    them, and later poses correct odometry. Ctrl-C stops the rover first. The motors are off after every end
    of the drive.

    Ends with 0 parked, 1 not parked (judged on the estimate; never parked after a bumper or a stall), 3 no
    bridge, no robot, not authorised or another driver, 4 stopped by a safety rule, which is named, 130
    interrupted.
    """
    from deploy.app import run
    from deploy.zenoh_client import BridgeAddress

    if record is None:
        reject("needs --record", overwrite=overwrite)
    return run(
        BridgeAddress(robot, namespace, zenoh_config),
        Output(json, controls=True),
        policy=policy,
        course=course,
        model=model,
        profile=profile,
        pose=pose,
        require_accuracy_m=require_accuracy,
        duration_s=duration,
        dry_run=dry_run,
        record=record,
        overwrite=overwrite,
    )


def replay(
    run: Annotated[Path, typer.Argument(help="A recording of 'rover-ncp deploy --record'.")],
    *,
    policy: Annotated[
        str | None, typer.Option(help="Recompute with this policy instead of the recorded one.")
    ] = None,
    json: Json = False,
) -> int:
    """Recompute a drive from its recorded odometry and compare every number with the recorded one.

    Estimator and circuit run again at the recorded moments; estimates, potentials and commands must come out
    the same to the last bit. Ends with 0 if they do, 1 if not, and names the first that does not.
    """
    from deploy.replay import replay as recompute

    found = recompute(run, policy)
    same = found.difference is None
    fields = {
        "same": same,  #: to the last bit
        "ticks": found.ticks,  #: that were compared
        "complete": found.complete,  #: false for a recording that was cut off
        "difference": found.difference,  #: the first one
    }
    cut = "" if found.complete else " (the recording was cut off; the rest was compared)"
    words = (
        f"{found.ticks} ticks, all the same to the last bit{cut}"
        if same
        else f"differs: {found.difference}{cut}"
    )
    Output(json).result(fields, words)
    return 0 if same else 1


def watch(
    *,
    robot: Robot,
    policy: Annotated[
        str, typer.Option(help="The policy that drives, by name or file; the page draws its neurons.")
    ] = "course",
    course: Annotated[str, typer.Option(help="The course that is driven, by name or file.")] = "parking",
    model: Annotated[
        str, typer.Option(help="The robot's description, for its outline: a name or a YAML file.")
    ] = DEFAULT_ROBOT,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Where this machine serves the page; 0 takes a free port.")
    ] = 8080,
    namespace: Namespace = "",
    zenoh_config: ZenohConfig = None,
    json: Json = False,
) -> int:
    """Show a robot's drive live on a page of this machine, with a Stop button.

    The page is that of 'rover-ncp report', updated ten times a second: path, circuit, commands, events. Its
    Stop button stops the rover until released. The page shows whether this user may stop the rover. Only
    this machine can open the page; the page shows the SSH command by which another device opens it. It is
    ready when it prints "watching at ADDRESS". Ctrl-C ends it and does not affect the rover.
    """
    from deploy.watch.server import run
    from deploy.zenoh_client import BridgeAddress

    address = BridgeAddress(robot, namespace, zenoh_config)
    return run(address, policy, course, port, Output(json, controls=True), model=model)


def check(
    *,
    robot: Robot,
    on_blocks: Annotated[
        bool, typer.Option("--on-blocks", help="The wheels are off the ground; the check turns them.")
    ] = False,
    model: Annotated[
        str | None,
        typer.Option(
            help="The robot's description, a name or a YAML file: what the bridge must drive, at its rate.",
            show_default=False,
        ),
    ] = None,
    namespace: Namespace = "",
    zenoh_config: ZenohConfig = None,
    json: Json = False,
) -> int:
    """Check a robot before it drives: on blocks, its wheels free.

    Checks odometry, battery, stop button and bumpers and requests the motors. Turns the wheels forward and
    then left for a moment and compares the reported motion with the commands. Ends with a test of the stop:
    it sends no more commands and measures how long the wheels go on. For a ROS 2 robot the bridge then sends
    nothing either, for 5 s at most, and measures when the robot halts by itself. Ends with 0 for yes, 1 for
    no, with the reason.
    """
    if not on_blocks:
        raise UsageError("the check turns the wheels: put the robot on blocks and give --on-blocks")
    from deploy.check import run
    from deploy.zenoh_client import BridgeAddress
    from rover_ncp.robot.description import load_description

    output = Output(json, controls=True)
    described = load_description(model) if model else None
    findings, locator = run(BridgeAddress(robot, namespace, zenoh_config), described)
    ready = all(finding.ok for finding in findings)
    lines = [f"{'ok ' if finding.ok else 'NO '} {finding.name:9} {finding.detail}" for finding in findings]
    verdict = "yes: it may drive" if ready else f"no: {findings[-1].name}: {findings[-1].detail}"
    output.result(
        {"ready": ready, "findings": findings, "robot": locator},
        "\n".join(map(printable, [*lines, verdict])),
    )
    return 0 if ready else 1
