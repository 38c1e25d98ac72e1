"""The ``mock`` command: reads its options, serves until a signal arrives, reports."""

import contextlib
import io
import os
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel, Field

from bridge.pioneer.odometry import ROBOTS
from bridge.ros2.discovery import Convention
from bridge.ros2.rmw import domain_id
from rover_ncp.core.console import Output
from rover_ncp.core.errors import UsageError
from rover_ncp.core.files import require_creatable
from rover_ncp.core.process import Interrupts
from rover_ncp.core.streams import Domain, integer_seed
from rover_ncp.course.course import load_course
from rover_ncp.robot.description import RobotDescription
from sim.pioneer.faults import Faults, parse_fault
from sim.pioneer.firmware import Firmware
from sim.pioneer.models import config_of
from sim.pioneer.real_time import TruthFile
from sim.pioneer.ros2_robot import Ros2Robot
from sim.pioneer.ros2_server import Ros2Server
from sim.pioneer.server import Server, parse_listen
from sim.pioneer.trial import BaseTrial, draw_rover
from sim.world.randomization import Randomization

CAMERA_HZ = 10.0
"""Pictures a second of a mock's camera."""
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
    bytes_in: int = Field(description="of commands")
    bytes_out: int = Field(description="of reports")
    touched: bool = Field(description="whether the rover touched anything")
    pose: TruePose = Field(description="the true one at the end")
    truth: str | None = Field(description="the file of true poses")


class PioneerMockResult(MockResult):
    """Result of the mock of a Pioneer."""

    connections: int = Field(description="on the line; a Pioneer's, as the other counters")
    packets: int = Field(description="that were received whole")
    bad_checksums: int = Field(description="packets that were dropped for it")
    skipped_bytes: int = Field(description="between packets")
    unknown_commands: int = Field(description="commands that a Pioneer does not have")
    bad_arguments: int = Field(description="known commands with an argument of a wrong kind or size")


class Ros2MockResult(MockResult):
    """Result of the mock of a ROS 2 robot."""

    ignored: int = Field(description="commands that were not applied, with --ros2")


def run_mock(
    *,
    listen: str,
    model: str,
    robot: RobotDescription,
    ros2: Convention | None,
    namespace: str,
    course: str | None,
    truth: Path | None,
    overwrite: bool,
    faults: Sequence[str],
    seed: int,
    ranges: Randomization,
    trial: int,
    gyro: bool,
    camera: tuple[Path, Path, str] | None,
    as_json: bool,
) -> None:
    """See ``commands.mock``; ``ros2`` is the form of a ROS 2 robot's topics.

    Raises RoverNcpError before anything listens.
    """
    output = Output(as_json, controls=True)
    host, port = parse_listen(listen)
    if ros2 is None and robot.arcos is None:
        raise UsageError(f"--model {model}: expected one of {', '.join(ROBOTS)}, or --ros2")
    if ros2 is not None and robot.topics is None:
        raise UsageError(f"--model {model}: the description has no topics, which a ROS 2 robot needs")
    fault_seed = integer_seed(seed, Domain.MOCK_FAULTS, trial)
    base_seed = integer_seed(seed, Domain.BASE_SENSORS, trial)
    injected = Faults([parse_fault(text) for text in faults if text != FROM_STDIN], fault_seed)
    # Unbuffered, so that the server's selector sees every line that is left to read.
    fault_lines = io.FileIO(0, closefd=False) if FROM_STDIN in faults else None
    known = load_course(course) if course else None
    rover, trials = draw_rover(ranges, robot, known, seed=seed, number=trial)
    base_trial, now = BaseTrial(trials), time.monotonic()
    if truth is not None:
        require_creatable(truth, overwrite=overwrite)
    server: Server | Ros2Server
    if ros2 is None:
        flash = replace(config_of(robot), has_gyro=int(gyro))
        firmware = Firmware(robot, rover, injected, now, config=flash, trial=base_trial, gyro_seed=base_seed)
        server = Server(host, port, firmware)
    else:
        epoch_s, domain = time.time() - now, domain_id(os.environ)
        ros2_robot = Ros2Robot(robot, rover, injected, now, epoch_s=epoch_s, trial=base_trial, seed=base_seed)
        server = Ros2Server(host, port, ros2_robot, convention=ros2, domain=domain, namespace=namespace)
    try:
        server.truth = TruthFile(truth, overwrite=overwrite) if truth else None
        with Interrupts() as interrupts, contextlib.ExitStack() as stack:
            if camera is not None:
                # The extra tag brings OpenCV, which no other mock needs.
                from sim.camera.server import MockCamera

                listen_on = parse_listen(camera[2], "--camera-listen")
                eye = stack.enter_context(MockCamera(camera[0], camera[1], listen_on, CAMERA_HZ, seed))
                server.camera = eye.pose
                output.announce(f"camera at {eye.address}")
            output.announce(f"listening on {server.host}:{server.port}")
            server.serve(lambda: interrupts.raised, fault_lines)
    finally:
        server.close()
    x, y, theta = rover.pose
    fields: dict[str, Any] = {
        "listen": f"{server.host}:{server.port}",
        "model": model,
        "bytes_in": server.bytes_in,
        "bytes_out": server.bytes_out,
        "touched": server.touched,
        "pose": TruePose(x=x, y=y, theta=theta),
        "truth": str(truth) if truth else None,
    }
    result: PioneerMockResult | Ros2MockResult
    if isinstance(server, Server):
        result = _of_pioneer(server, fields)
        came = f"{result.connections} connections, {result.packets} packets"
    else:
        result = Ros2MockResult(**fields, ignored=server.robot.ignored)
        came = f"{result.bytes_in} bytes of commands"
    output.result(
        result.model_dump(), f"{came}; the rover stands at x={x:.3f} m, y={y:.3f} m, theta={theta:.3f} rad"
    )


def _of_pioneer(server: Server, fields: dict[str, Any]) -> PioneerMockResult:
    """Return the result with the counters of a Pioneer's line."""
    firmware = server.firmware
    return PioneerMockResult(
        **fields,
        connections=server.connections,
        packets=firmware.decoder.packets,
        bad_checksums=firmware.decoder.bad_checksums,
        skipped_bytes=firmware.decoder.skipped_bytes,
        unknown_commands=sum(firmware.unknown.values()),
        bad_arguments=sum(firmware.bad_arguments.values()),
    )
