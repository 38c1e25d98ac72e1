"""``rover-ncp deploy`` with ticks of another length.

    python -m sim.benchmarks.driver deploy ROBOT COURSE RECORDING PERIOD_S --json

It is for the benchmark alone.
"""

import sys
from pathlib import Path

from deploy.app import run
from deploy.drive.config import DriveConfig
from deploy.recorder import Recorder
from deploy.zenoh_client import BridgeAddress
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.console import Output
from rover_ncp.course.course import load_course


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
    sys.exit(_deploy(*sys.argv[2:-1]))
