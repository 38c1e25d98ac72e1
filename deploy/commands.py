"""Commands of this package; heavy libraries load only when one runs."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from rover_ncp.core.console import Json, Output, Overwrite


def deploy(
    *,
    robot: Annotated[
        str,
        typer.Option(help="Where the bridge listens: PROTOCOL/HOST[:PORT], such as tcp/192.168.1.20."),
    ],
    policy: Annotated[
        str, typer.Option(help="Policy by name, or by file (YAML, or a published .bnn circuit).")
    ] = "course",
    course: Annotated[
        str, typer.Option(help="Course by name or file: goal, start signal, time.")
    ] = "parking",
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
            "or leave them alone."
        ),
    ] = "auto",
    profile: Annotated[
        Path | None,
        typer.Option(
            help="The robot's profile, as 'identify' writes it: the drive compensates its gains and uses its "
            "odometry's noise.",
            show_default=False,
        ),
    ] = None,
    namespace: Annotated[str, typer.Option(help="The robot's namespace, such as bot1.")] = "",
    zenoh_config: Annotated[
        Path | None, typer.Option(help="Zenoh configuration (JSON5) with certificates or user and password.")
    ] = None,
    json: Json = False,
) -> int:
    """Let a circuit drive the robot behind a bridge.

    Waits for the bridge and for a rover that stands still, takes its place as the course's origin, requests
    the motors and drives the course. If external poses arrive on 'pose' meanwhile, it starts from them, and
    later poses correct odometry. Ctrl-C stops the rover first. The motors are off after every end of the
    drive.

    Ends with 0 parked, 1 not parked (judged on the estimate), 3 no bridge, no robot, not authorised or
    another driver, 4 stopped by a safety rule, which is named, 130 interrupted.
    """
    from deploy.app import Options, run

    options = Options(
        robot, policy, course, record, duration, dry_run, namespace, zenoh_config, pose, profile, overwrite
    )
    return run(options, Output(json, controls=True))


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
        "same": same,
        "ticks": found.ticks,
        "complete": found.complete,
        "difference": vars(found.difference) if found.difference else None,
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
    robot: Annotated[
        str,
        typer.Option(help="Where the bridge listens: PROTOCOL/HOST[:PORT], such as tcp/192.168.1.20."),
    ],
    policy: Annotated[
        str, typer.Option(help="The policy that drives, by name or file: whose neurons to draw.")
    ] = "course",
    course: Annotated[str, typer.Option(help="The course that is driven, by name or file.")] = "parking",
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Where this machine serves the page; 0 takes a free port.")
    ] = 8080,
    namespace: Annotated[str, typer.Option(help="The robot's namespace, such as bot1.")] = "",
    zenoh_config: Annotated[
        Path | None, typer.Option(help="Zenoh configuration (JSON5) with certificates or user and password.")
    ] = None,
    json: Json = False,
) -> int:
    """Show a robot's drive live on a page of this machine, with a Stop button.

    The page is that of 'rover-ncp report', fed ten times a second: path, circuit, commands, events. Its
    Stop button stops the rover until released; a viewer who is not authorised to stop sees that it is not.
    Only this machine can open the page. It is ready when it prints "watching at ADDRESS"; Ctrl-C ends it,
    and changes nothing about the rover.
    """
    from deploy.watch.server import Options, run

    options = Options(robot, policy, course, port, namespace, zenoh_config)
    return run(options, Output(json, controls=True))
