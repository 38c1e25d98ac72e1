"""Commands of this package; heavy libraries load only when one runs."""

from rover_ncp.core.console import command, reject
from rover_ncp.core.errors import UsageError
from sim.mock.options import MockOptions


@command
def mock(options: MockOptions) -> None:
    """Simulate a Pioneer: its firmware on a simulated rover, over TCP, in real time; or a ROS 2 robot.

    Every program that drives a Pioneer can drive the mock: rover-ncp bridge, ARIA, Player, Soar. The rover
    starts at the origin. Delays, acceleration limits, the watchdog and walls act as on a real one. When the
    mock is ready, it prints the line "listening on HOST:PORT"; Ctrl-C or SIGTERM ends it.

    With --ros2 it is a Zenoh router with the topics of the robot that --model describes. Its fault
    stop-button stops the motors; the robot reports it only if the description has topics.stop. The fault
    bumper acts only if the description has topics.hazards. The fault reset restarts the robot.

    --truth writes t_ns (since the epoch), t_s, x, y, theta, v, omega, contact and clock_ns (the simulation's
    clock). With --fault - each fault is answered by a line "applied t_ns=... late_ns=... heard_ns=... FAULT":
    t_ns is when it began on that clock, late_ns the longest stall of the mock since the line before, heard_ns
    when the robot last received anything.

    With --randomize the mock has the errors of one random trial: its delays, gains, noise and start, lost
    commands and a push, for as long as the --course lasts. All but the start begin when the motors are first
    enabled.

    --camera renders what a camera sees of the tags from the true pose, ten times a second, in a process of
    its own; 'tag run --camera http://127.0.0.1:8102/' reads it. --camera needs the extra 'tag'.

    --body mujoco simulates four wheels with friction, weight and motors, on level or sloped ground.

        rover-ncp mock --randomize full --truth truth.csv
        rover-ncp mock --ros2 --model turtlebot4
    """
    from sim.mock.run import run_mock

    if options.ros2:
        reject("a ROS 2 robot's gyro is in its description", gyro=options.gyro)
    else:
        reject("needs --ros2", ros=options.ros, namespace=options.namespace)
    if options.truth is None:
        reject("needs --truth", overwrite=options.overwrite)
    if options.camera is None:
        reject("needs --camera", tags=options.tags, camera_listen=options.camera_listen)
    elif options.tags is None:
        raise UsageError("--camera: needs --tags")
    run_mock(options)
