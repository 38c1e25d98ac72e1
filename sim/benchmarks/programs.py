"""The processes of ``bench deploy``.

    python -m sim.benchmarks.programs echo ROBOT
    python -m sim.benchmarks.programs deploy ROBOT COURSE RECORDING PERIOD_S

``echo`` is one end of a bare ping-pong over Zenoh: it sends back each message as soon as it can, until
SIGTERM. ``deploy`` is ``rover-ncp deploy`` with ticks of another length, which is for the benchmark alone.
"""

import signal
import sys
from pathlib import Path

import zenoh

from deploy.app import run
from deploy.zenoh_client import BridgeAddress
from rover_ncp.core.console import Output
from rover_ncp.wire.zenoh import client_config

PING, PONG = "bench/ping", "bench/pong"


def _echo(robot: str) -> int:
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    config, _ = client_config(robot, None)
    with zenoh.open(config) as session:
        pong = session.declare_publisher(PONG, congestion_control=zenoh.CongestionControl.DROP)
        ping = session.declare_subscriber(PING, lambda sample: pong.put(sample.payload))
        print("ready", file=sys.stderr, flush=True)
        signal.sigwait({signal.SIGTERM})
        ping.undeclare()  # type: ignore[no-untyped-call]
    return 0


def _deploy(robot: str, course: str, recording: str, period_s: str) -> int:
    address, output, period = BridgeAddress(robot), Output(True), float(period_s)
    return run(address, output, policy="parking", course=course, record=Path(recording), period_s=period)


if __name__ == "__main__":
    _, program, *arguments, _ = sys.argv  # the last one is --json
    sys.exit(_echo(*arguments) if program == "echo" else _deploy(*arguments))
