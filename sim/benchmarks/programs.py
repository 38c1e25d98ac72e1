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
from deploy.drive.config import DriveConfig
from deploy.recorder import Recorder
from deploy.zenoh_client import BridgeAddress
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.console import Output
from rover_ncp.course.course import load_course
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
    policy, goal = load_policy("parking"), load_course(course)
    config = DriveConfig(robot=robot, policy="parking", course=goal.name, ticks=goal.ticks)
    return run(
        BridgeAddress(robot),
        Output(True),
        policy=policy,
        course=goal,
        config=config,
        recorder=Recorder(Path(recording)),
        period_s=float(period_s),
    )


if __name__ == "__main__":
    _, program, *arguments, _ = sys.argv  # the last one is --json
    sys.exit(_echo(*arguments) if program == "echo" else _deploy(*arguments))
