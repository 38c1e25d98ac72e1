"""The ``mock`` command: reads its options, serves until a signal arrives, reports."""

import io
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from bridge.pioneer.robots import ROBOTS
from rover_ncp.core.console import Output
from rover_ncp.core.errors import UsageError
from rover_ncp.core.process import Interrupts
from rover_ncp.course.course import load_course
from sim.pioneer.faults import Faults, parse_fault
from sim.pioneer.firmware import Firmware
from sim.pioneer.models import config_of, rover_model_of
from sim.pioneer.server import Server, TruthFile, parse_listen
from sim.pioneer.trial import BaseTrial, draw_rover
from sim.world.bodies import Body
from sim.world.randomization import Randomization

FROM_STDIN = "-"
"""In place of a fault: read more faults from standard input."""


def run_mock(
    *,
    listen: str,
    model: str,
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
    """See ``commands.mock``. Raises UsageError, PortInUse or FileError before anything listens."""
    output = Output(as_json, controls=True)
    host, port = parse_listen(listen)
    if model not in ROBOTS:
        raise UsageError(f"--model {model}: expected one of {', '.join(ROBOTS)}")
    if ranges.body is Body.MUJOCO and not model.startswith("p3at"):
        raise UsageError(f"--model {model}: the body mujoco has four wheels, expected p3at or p3at-sh")
    injected = Faults([parse_fault(text) for text in faults if text != FROM_STDIN], seed)
    # Unbuffered, so that the server's selector sees every line that is left to read.
    fault_lines = io.FileIO(sys.stdin.fileno(), closefd=False) if FROM_STDIN in faults else None
    known = load_course(course) if course else None
    ideal = rover_model_of(ROBOTS[model])
    rover, trials = draw_rover(ranges, ideal, known, seed=seed, number=trial)
    flash = replace(config_of(model), has_gyro=int(gyro))

    firmware = Firmware(
        model, rover, injected, time.monotonic(), config=flash, trial=BaseTrial(trials), gyro_seed=seed
    )
    server = Server(
        host, port, firmware, TruthFile(truth, overwrite=overwrite) if truth else None, output.say
    )
    try:
        with Interrupts() as interrupts:
            output.announce(f"listening on {server.host}:{server.port}")
            server.serve(lambda: interrupts.raised, fault_lines)
    finally:
        server.close()
    pose = rover.pose
    output.result(
        {
            "listen": f"{server.host}:{server.port}",
            "model": model,
            "connections": server.connections,
            "bytes_in": server.bytes_in,
            "bytes_out": server.bytes_out,
            "packets": firmware.decoder.packets,
            "bad_checksums": firmware.decoder.bad_checksums,
            "skipped_bytes": firmware.decoder.skipped_bytes,
            "unknown_commands": sum(firmware.unknown.values()),
            "bad_arguments": sum(firmware.bad_arguments.values()),
            "touched": server.touched,
            "pose": {"x": pose.x, "y": pose.y, "theta": pose.theta},
            "truth": str(truth) if truth else None,
        },
        f"{server.connections} connections, {firmware.decoder.packets} packets; "
        f"the rover stands at x={pose.x:.3f} m, y={pose.y:.3f} m, theta={pose.theta:.3f} rad",
    )
