"""The ``mock`` command: reads its options, serves until a signal arrives, reports."""

import io
import signal
import socket
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from bridge.pioneer.robots import ROBOTS
from rover_ncp.core.console import Output
from rover_ncp.core.errors import UsageError
from rover_ncp.course.course import load_course
from sim.pioneer.faults import Faults, parse_fault
from sim.pioneer.firmware import Firmware
from sim.pioneer.models import rover_model_of
from sim.pioneer.server import Server, TruthFile, parse_listen
from sim.pioneer.trial import BaseTrial, rover_of
from sim.world.pymunk_rover import Ground
from sim.world.randomization import Randomization, draw_trials

TRIAL_TICKS = 600
"""Length of a trial without a course; its noise then begins again."""
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
    as_json: bool,
) -> None:
    """See ``commands.mock``. Raises UsageError, PortInUse or FileError before anything listens."""
    output = Output(as_json, controls=True)
    host, port = parse_listen(listen)
    if model not in ROBOTS:
        raise UsageError(f"--model {model}: expected one of {', '.join(ROBOTS)}")
    injected = Faults([parse_fault(text) for text in faults if text != FROM_STDIN], seed)
    # Unbuffered, so that the server's selector sees every line that is left to read.
    fault_lines = io.FileIO(sys.stdin.fileno(), closefd=False) if FROM_STDIN in faults else None
    known = load_course(course) if course else None
    ideal = rover_model_of(ROBOTS[model])
    ticks = known.ticks if known else TRIAL_TICKS
    trials = draw_trials(ranges, ideal, seed, count=1, ticks=ticks, first=trial)
    rover = rover_of(trials, ideal, Ground(known.obstacles if known else ()))

    def make(start_s: float, observe: Callable[[float], None]) -> Firmware:
        return Firmware(model, rover, injected, start_s, observe, trial=BaseTrial(trials))

    server = Server(host, port, make, TruthFile(truth, overwrite=overwrite) if truth else None, output.say)
    try:
        with _until_signal() as wake:
            output.announce(f"listening on {server.host}:{server.port}")
            server.serve(wake, fault_lines)
    finally:
        server.close()
    firmware, pose = server.firmware, rover.pose
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


@contextmanager
def _until_signal() -> Iterator[socket.socket]:
    """Give a socket that becomes readable when SIGINT or SIGTERM comes, instead of their usual effect."""
    wake, bell = socket.socketpair()
    bell.setblocking(False)
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    fd = signal.set_wakeup_fd(bell.fileno())
    for number in before:
        signal.signal(number, lambda *_: None)
    try:
        yield wake
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(fd)
        wake.close()
        bell.close()
