"""The ``mock`` command: reads its options, serves until a signal arrives, reports."""

import io
import os
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

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

FROM_STDIN = "-"
"""In place of a fault: read more faults from standard input."""


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
        with Interrupts() as interrupts:
            output.announce(f"listening on {server.host}:{server.port}")
            server.serve(lambda: interrupts.raised, fault_lines)
    finally:
        server.close()
    pose = rover.pose
    came = f"{server.bytes_in} bytes of commands"
    if isinstance(server, Server):
        came = f"{server.connections} connections, {server.firmware.decoder.packets} packets"
    output.result(
        {
            "listen": f"{server.host}:{server.port}",  #: its address
            "model": model,  #: the description
            "bytes_in": server.bytes_in,  #: of commands
            "bytes_out": server.bytes_out,  #: of reports
            **(_of_firmware(server) if isinstance(server, Server) else {"ignored": server.robot.ignored}),
            "touched": server.touched,  #: whether the rover touched anything
            "pose": {"x": pose.x, "y": pose.y, "theta": pose.theta},  #: the true one at the end, m and rad
            "truth": str(truth) if truth else None,  #: the file of true poses
        },
        f"{came}; the rover stands at x={pose.x:.3f} m, y={pose.y:.3f} m, theta={pose.theta:.3f} rad",
    )


def _of_firmware(server: Server) -> dict[str, int]:
    """Return the counters of a Pioneer's line."""
    firmware = server.firmware
    return {
        "connections": server.connections,  #: not with --ros2, as the other counters
        "packets": firmware.decoder.packets,
        "bad_checksums": firmware.decoder.bad_checksums,
        "skipped_bytes": firmware.decoder.skipped_bytes,
        "unknown_commands": sum(firmware.unknown.values()),
        "bad_arguments": sum(firmware.bad_arguments.values()),
    }
