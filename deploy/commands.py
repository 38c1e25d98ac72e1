"""Commands of this package; heavy libraries load only when one runs."""

import math
from pathlib import Path
from typing import Annotated, Literal

import typer

from deploy.options import Namespace, Robot, ZenohConfig, choose_robot
from rover_ncp.core.console import Json, Output, Overwrite, printable, reject
from rover_ncp.core.errors import UsageError
from rover_ncp.core.files import DEFAULT_ROBOT
from rover_ncp.wire.key_table import Role

DEFAULT_PORT = 8080
"""Where `watch` serves its page."""
Model = Annotated[
    str | None, typer.Option(help="The robot's description, a name or a YAML file.", show_default=False)
]
Record = Annotated[
    Path | None,
    typer.Option(
        help="Record the drive to this new MCAP file, or in this folder to one named by the time.",
        show_default=False,
    ),
]


def deploy(
    *,
    robot: Robot = None,
    policy: Annotated[
        str, typer.Option(help="Policy by name or file, or module:name for a policy in Python.")
    ] = "course",
    course: Annotated[
        str | None, typer.Option(help="Course by name or file.", show_default="parking")
    ] = None,
    to: Annotated[
        str | None,
        typer.Option(
            help="Dock at a place: its name or file, as 'rover-ncp place set' writes it.", show_default=False
        ),
    ] = None,
    undock: Annotated[
        str | None,
        typer.Option(help="Back out of a place, to its staging pose.", show_default=False),
    ] = None,
    dock_policy: Annotated[
        str | None,
        typer.Option(
            help="With --to or --undock: the policy between the staging pose and the place. --policy drives "
            "to the staging pose.",
            show_default="dock",
        ),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(
            help="The robot's description, a name or a YAML file: the course takes longer for a slow robot, "
            "and the estimator expects its errors.",
            show_default="p3at-sh, as in the training",
        ),
    ] = None,
    record: Record = None,
    duration: Annotated[
        float | None,
        typer.Option(min=0.1, help="End after so many seconds, if the course would last longer."),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Send no commands and do not request the motors.")
    ] = False,
    pose: Annotated[
        Literal["auto", "required", "none"],
        typer.Option(help="External poses on 'pose': use them if they come, wait for them, or ignore them."),
    ] = "auto",
    require_certainty: Annotated[
        bool, typer.Option("--require-certainty", help="Exit 1 if the rover is 'parked, uncertain'.")
    ] = False,
    profile: Annotated[
        Path | None, typer.Option(help="The robot's profile, as 'identify' writes it.", show_default=False)
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

    Poses farther than 0.3 m in x or y or 20° from the course's start end the command (4, start-pose). With
    --pose required it waits 10 s for a pose (3 without one), and 3 s of motion without a pose that fits end
    the drive (4, pose-age).

    With --to it waits for an external pose, and turns once on the spot to find its tags if none comes. It
    drives to the staging pose of a place and from there into it, tries again after a miss, and ends docked
    (0) or back at the staging pose (1; docs/place.md). Without tags it ends with 4 (start-pose). With
    --dry-run it plans the first way, and ends with 4 if there is none, or with 3 if no pose comes.

    The estimate is judged: parked; not parked, also after a bumper or a stall; or "parked, uncertain" if the
    rover may be outside the tolerances with a probability of more than 5 %. Ends with 0 parked, 1 not parked,
    3 no bridge, no robot, not authorised or another driver, 4 stopped by a safety rule, which is named, 130
    interrupted.

        rover-ncp deploy --robot tcp/192.168.1.20 --record run.mcap

    module:name is a policy of your own in Python, as 'rover-ncp eval' takes it. It drives courses, and its
    drive is not recorded. An exception in it ends the drive (2); after 0.3 s in it the gate stops the rover.
    """
    if duration == math.inf:
        raise UsageError(f"--duration {duration}: expected seconds")
    from deploy.app import run
    from deploy.drive.config import config_for
    from deploy.recorder import Recorder
    from rover_ncp.circuit.own_policy import is_own, load_own_policy
    from rover_ncp.circuit.policy import Policy
    from rover_ncp.circuit.policy_file import load_policy
    from rover_ncp.course.course import TICK_S, load_course
    from rover_ncp.course.slowdown import slowed
    from rover_ncp.robot.profile import load_profile

    if own := is_own(policy):
        other = f"does not go with --policy {policy}, which is no circuit"
        reject(other, record=record, to=to, undock=undock)
    output, recorder = Output(json, controls=True), Recorder(record)
    driver = load_own_policy(policy) if own else load_policy(policy)
    chosen = choose_robot(robot, namespace, zenoh_config, model)
    address, described = chosen.address, chosen.described
    rover = load_profile(profile) if profile else None
    if to is not None or undock is not None:
        from deploy.drive.config import place_config
        from deploy.place.place import load_place
        from deploy.place.plan import approach

        if to is not None and undock is not None:
            raise UsageError("--to and --undock do not go together")
        odd = None if pose == "auto" else pose
        given = {"course": course, "duration": duration, "pose": odd}
        reject("does not go with --to and --undock", **given, require_certainty=require_certainty)
        place, dock = load_place(to or undock or "", chosen.places), load_policy(dock_policy or "dock")
        config = place_config(
            place,
            rover,
            described,
            undock=undock is not None,
            sight=chosen.sight(place),
            robot=address.robot,
            namespace=address.namespace,
            policy=dock.circuit.name,
            dry_run=dry_run,
        )
        way = approach(place).course
        return run(
            address,
            output,
            policy=dock,
            course=way,
            config=config,
            recorder=recorder,
            staging=load_policy(policy),
        )
    reject("needs --to or --undock", dock_policy=dock_policy)
    goal = load_course(course or "parking")
    if described is not None:
        goal, pace = slowed(goal, described)
        output.say(pace)
    config = config_for(
        goal,
        rover,
        described,
        robot=address.robot,
        namespace=address.namespace,
        policy=driver.circuit.name if isinstance(driver, Policy) else driver.name,
        dry_run=dry_run,
        ticks=goal.ticks if duration is None else min(goal.ticks, round(duration / TICK_S)),
        pose=pose,
        require_certainty=require_certainty,
    )
    return run(address, output, policy=driver, course=goal, config=config, recorder=recorder)


def replay(
    run: Annotated[Path, typer.Argument(help="A recording of 'rover-ncp deploy --record'.")],
    *,
    json: Json = False,
) -> int:
    """Recompute a drive from its recorded odometry, and compare each estimate and command with the record.

    A damaged recording, or one of another version of the estimator, is refused (2); 'report' reads both.
    Estimator and circuit run again at the recorded moments; estimates and commands must come out the
    same to the last bit. Ends with 0 if they do, 1 if not, and names the first that does not.

        rover-ncp replay run.mcap
    """
    from deploy.replay import replay as recompute

    found = recompute(run)
    Output(json).result(found, str(found))
    return 0 if found.same else 1


def watch(
    *,
    robot: Robot = None,
    policy: Annotated[
        str, typer.Option(help="The policy that drives, by name or file; the page draws its neurons.")
    ] = "course",
    course: Annotated[str, typer.Option(help="The course that is driven, by name or file.")] = "parking",
    model: Annotated[
        str | None,
        typer.Option(
            help="The robot's description, a name or a YAML file, as for 'deploy': the page draws its "
            "outline, and the course takes longer for a slow robot.",
            show_default=DEFAULT_ROBOT,
        ),
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=65535,
            help="Where this machine serves the page; 0 takes a free port.",
            show_default="8080",
        ),
    ] = None,
    namespace: Namespace = "",
    zenoh_config: ZenohConfig = None,
    json: Json = False,
) -> int:
    """Show a robot's drive live on a page of this machine, with a Stop button.

    The page is that of 'rover-ncp report', updated ten times a second: path, circuit, commands, events and
    the driver's own verdict. It draws currents only if the driver names the same policy and course, and no
    docking; 'report' judges and explains a recorded drive. Its Stop button stops the rover until released.
    The page shows whether this user may stop the rover. Only this machine can open the page; the page shows
    the SSH command by which another device opens it. It is ready when it prints "watching at ADDRESS". Ctrl-C
    ends it and does not affect the rover.

        rover-ncp watch --robot tcp/192.168.1.20
    """
    from deploy.view.server import run

    chosen = choose_robot(robot, namespace, zenoh_config, model, Role.VIEWER)
    if port is None:
        port = chosen.file.settings.page if chosen.file else None
    output = Output(json, controls=True)
    port, model = DEFAULT_PORT if port is None else port, chosen.model or DEFAULT_ROBOT
    return run(chosen.address, policy, course, port, output, model=model)


def check(
    *,
    robot: Robot = None,
    on_blocks: Annotated[
        bool, typer.Option("--on-blocks", help="The wheels are off the ground; the check turns them.")
    ] = False,
    on_floor: Annotated[
        bool, typer.Option("--on-floor", help="The robot has 2 m free ahead and 0.5 m to each side.")
    ] = False,
    model: Model = None,
    namespace: Namespace = "",
    zenoh_config: ZenohConfig = None,
    json: Json = False,
) -> int:
    """Check a robot before it drives: on blocks, its wheels free, or on a free floor.

    Each line says what was measured and what would be right. Ends at the first finding that is not ok. Checks
    the link, odometry, sensors, battery, stop button and bumpers, and requests the motors. Turns the wheels
    forward, slowly, and then left, and compares the reported motion with the commands, and that of gyro,
    laser and external poses with odometry. On blocks these show no motion, and are not known; on the floor
    that is a fault. Then it sends no more commands and measures when the wheels stop. It reports when the
    base halts by itself if the bridge dies, and how that is known. With --model, the bridge must drive
    that model, and odometry must come at its rate. Ends with 0 for yes, 1 for no, with the reason.

        rover-ncp check --robot tcp/192.168.1.20 --on-blocks
    """
    if on_blocks == on_floor:
        raise UsageError(
            "the check turns the wheels: put the robot on blocks and give --on-blocks, or on a free floor "
            "and give --on-floor"
        )
    from deploy.check import run

    output, chosen = Output(json, controls=True), choose_robot(robot, namespace, zenoh_config, model)
    found = run(chosen.address, chosen.described, on_floor=on_floor)
    lines = [f"{'ok ' if each.ok else 'NO '} {each.name:9} {each.detail}" for each in found.findings]
    last = found.findings[-1]
    verdict = "yes: it may drive" if found.ready else f"no: {last.name}: {last.detail}"
    output.result(found, "\n".join(map(printable, [*lines, verdict])))
    return 0 if found.ready else 1


def teleop(
    *,
    robot: Robot = None,
    topic: Annotated[
        str | None,
        typer.Option(
            help="Pass on the commands of a ROS node on this topic, such as cmd_vel, instead of keys.",
            show_default=False,
        ),
    ] = None,
    model: Model = None,
    record: Record = None,
    namespace: Namespace = "",
    zenoh_config: ZenohConfig = None,
    json: Json = False,
) -> int:
    """Drive the robot behind a bridge with the keyboard or by a ROS node, through a lease.

    Hold a key to drive, release it to stop. u i o, j k l and m , . drive in the direction in which they lie
    around k, which stops; the arrows do as i , j l. A terminal reports a held key only by repeating it, so a
    key counts for 0.4 s after it was last sent. A single press is a small step at half speed. q and Ctrl-C
    stop the rover and release the lease.
    With --model, commands that are too slow for the robot's motors become pulses.

    Standard input has to be a terminal, whose settings are restored at the end.

    With --topic, each Twist or TwistStamped of one ROS node at a time is passed on. The motors are requested
    with a zero command 0.3 s after the last other one, or with the first command after 1 s without one. They
    are released after 1 s without a command, so that another driver can follow. Ctrl-C ends it.

    It drives through the same lease, gate and limits as 'rover-ncp deploy'; 'rover-ncp course new' makes a
    course of a recording. Ends with 0, 3 no bridge, no robot, not authorised or another driver, 4 stopped by
    a safety rule, which is named, 130 Ctrl-C.

        rover-ncp teleop --robot tcp/192.168.1.20 --record taught.mcap
        rover-ncp teleop --robot tcp/192.168.1.20 --topic cmd_vel
    """
    from deploy.recorder import Recorder
    from deploy.teleop import run

    if topic is not None:
        reject("does not go with --topic, which passes commands on as they are", model=model)
    chosen = choose_robot(robot, namespace, zenoh_config, model)
    recorder, output = Recorder(record), Output(json, controls=True)
    described = None if topic is not None else chosen.described
    return run(chosen.address, recorder, output, robot=described, topic=topic)


def identify(
    *,
    robot: Robot = None,
    model: Model = None,
    out: Annotated[Path, typer.Option(help="The rover profile to write (YAML).")] = Path("rover.yaml"),
    fence: Annotated[
        float, typer.Option(min=0.1, max=5.0, help="How far it may come from its start, m.")
    ] = 0.8,
    record: Record = None,
    overwrite: Overwrite = False,
    namespace: Namespace = "",
    zenoh_config: ZenohConfig = None,
    json: Json = False,
) -> int:
    """Measure a robot: its delays, accelerations, gains and noise, as a profile.

    Drives for a minute, forward and back by half a metre, then left and right, at walking pace, through the
    same lease and gate as 'rover-ncp deploy'; keep a circle of --fence metres around it free. Ctrl-C stops
    the rover. With --model, steps are no faster than the robot drives, and mean speeds that some robots
    report are corrected. Each value is shown ± its standard deviation. A value with too large a deviation
    is left out.

        rover-ncp identify --robot tcp/192.168.1.20 --out profile.yaml
        rover-ncp eval course --trials 300 --randomize full --profile profile.yaml
        rover-ncp deploy --robot tcp/192.168.1.20 --policy course --profile profile.yaml

    Gains are those that odometry measures. With external poses on 'pose' during the drive, gains are
    separated from odometry's own errors, and slip, wheel mismatch and centre of rotation are measured too.

    Ends with 0, 1 when a delay or gain could not be determined, 3 no bridge, no robot, not authorised or
    another driver, 4 stopped by a safety rule, which is named, 130 Ctrl-C.
    """
    from deploy.identify.run import identify_robot
    from deploy.recorder import Recorder

    chosen, recorder = choose_robot(robot, namespace, zenoh_config, model), Recorder(record)
    described, output = chosen.described, Output(json, controls=True)
    return identify_robot(chosen.address, recorder, fence, out, output, robot=described, overwrite=overwrite)
