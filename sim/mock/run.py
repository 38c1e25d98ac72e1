"""The ``mock`` command: reads its options, serves until a signal arrives, reports."""

import contextlib
import io
import os
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import BaseModel, Field

from bridge.pioneer.odometry import ROBOTS
from bridge.ros2.discovery import Convention
from bridge.ros2.rmw import domain_id
from rover_ncp.core.console import Output
from rover_ncp.core.errors import UsageError
from rover_ncp.core.files import require_writable
from rover_ncp.core.process import Interrupts
from rover_ncp.core.streams import Domain, integer_seed
from rover_ncp.course.course import load_course
from rover_ncp.robot.description import RobotDescription, load_description
from sim.base.faults import Faults, parse_fault
from sim.base.firmware import Firmware
from sim.base.models import config_of
from sim.base.ros2_robot import Ros2Robot
from sim.base.trial import BaseTrial, draw_rover
from sim.mock.options import MockOptions
from sim.mock.real_time import TruthFile
from sim.mock.ros2_server import Ros2Server
from sim.mock.server import Server, parse_listen
from sim.world.bodies import PRESETS
from sim.world.described import ranges_for
from sim.world.rover import Rover

if TYPE_CHECKING:
    from sim.camera.server import MockCamera

CAMERA_HZ, CAMERA_LISTEN = 10.0, "127.0.0.1:8102"
"""Pictures a second of a mock's camera, and where they are served."""
FROM_STDIN = "-"
"""In place of a fault: read more faults from standard input."""


class TruePose(BaseModel):
    """Pose of the simulated rover."""

    x: float = Field(description="in m")
    y: float = Field(description="in m")
    theta: float = Field(description="its heading in rad")


class MockResult(BaseModel):
    """Result of the command ``mock``."""

    listen: str = Field(description="its address")
    model: str = Field(description="the robot's description")
    touched: bool = Field(description="whether the rover touched anything")
    ignored: int = Field(
        description="commands that the robot could not use: of another type, late or unreadable"
    )
    pose: TruePose = Field(description="the true one at the end")
    truth: str | None = Field(description="the file of true poses")


def run_mock(options: MockOptions) -> None:
    """Serve until a signal arrives, and print the result. Raises RoverNcpError before anything listens."""
    output = Output(options.json, controls=True)
    model, seed, trial, truth = options.model, options.seed, options.trial, options.truth
    robot = load_description(model)
    preset = PRESETS[options.body][0] if options.randomize is None else options.randomize
    ranges = ranges_for(preset, options.profile, options.body, robot)
    if not options.ros2 and robot.arcos is None:
        raise UsageError(f"--model {model}: expected one of {', '.join(ROBOTS)}, or --ros2")
    if options.ros2 and robot.topics is None:
        raise UsageError(f"--model {model}: the description has no topics, which a ROS 2 robot needs")
    faults = options.fault or []
    fault_seed = integer_seed(seed, Domain.MOCK_FAULTS, trial)
    injected = Faults([parse_fault(text) for text in faults if text != FROM_STDIN], fault_seed)
    # Unbuffered, so that the server's selector sees every line that is left to read.
    fault_lines = io.FileIO(0, closefd=False) if FROM_STDIN in faults else None
    course = load_course(options.course) if options.course else None
    rover, trials = draw_rover(ranges, robot, course, seed=seed, number=trial)
    if truth is not None:
        require_writable(truth, overwrite=options.overwrite)
    with Interrupts() as interrupts, contextlib.ExitStack() as stack:
        # First the camera, which starts for seconds: a client that connects meanwhile would get no answer.
        eye = None
        if options.camera is not None and options.tags is not None:
            eye = stack.enter_context(_camera(options.camera, options.tags, options))
        server = stack.enter_context(
            contextlib.closing(_server(options, robot, rover, injected, BaseTrial(trials)))
        )
        server.truth = TruthFile(truth, overwrite=options.overwrite) if truth else None
        if eye is not None:
            server.show = eye.show
            output.announce(f"camera at {eye.address}")
        output.announce(f"listening on {server.host}:{server.port}")
        server.serve(lambda: interrupts.raised, fault_lines)
    (x, y, theta), ignored = rover.pose, server.base.ignored
    result = MockResult(
        listen=f"{server.host}:{server.port}",
        model=model,
        touched=server.touched,
        ignored=ignored,
        pose=TruePose(x=x, y=y, theta=theta),
        truth=str(truth) if truth else None,
    )
    where = f"the rover stands at x={x:.3f} m, y={y:.3f} m, theta={theta:.3f} rad"
    output.result(result, f"{where}; {ignored} commands could not be used" if ignored else where)


def _camera(camera: Path, tags: Path, options: MockOptions) -> "MockCamera":
    """Return a mock's camera, not running yet."""
    # The extra tag brings OpenCV, which no other mock needs.
    from sim.camera.server import MockCamera

    listen_on = parse_listen(options.camera_listen or CAMERA_LISTEN, "--camera-listen")
    return MockCamera(camera, tags, listen_on, CAMERA_HZ, options.seed)


def _server(
    options: MockOptions, robot: RobotDescription, rover: Rover, faults: Faults, trial: BaseTrial
) -> Server | Ros2Server:
    """Return the server of a base on a rover, which listens from now on."""
    host, port = parse_listen(options.listen)
    now, seed = time.monotonic(), integer_seed(options.seed, Domain.BASE_SENSORS, options.trial)
    if not options.ros2:
        flash = replace(config_of(robot), has_gyro=int(options.gyro))
        firmware = Firmware(robot, rover, faults, now, config=flash, trial=trial, gyro_seed=seed)
        return Server(host, port, firmware)
    epoch_s = time.time() - now
    return Ros2Server(
        host,
        port,
        Ros2Robot(robot, rover, faults, now, epoch_s=epoch_s, trial=trial, seed=seed),
        convention=options.ros or Convention.ROS2DDS,
        domain=domain_id(os.environ),
        namespace=options.namespace,
    )
