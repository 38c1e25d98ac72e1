"""``rover-ncp deploy`` with ticks of another length, which is for the benchmark alone.

Run as ``python -m sim.benchmarks.deploy_driver deploy ROBOT COURSE RECORDING PERIOD_S --json``.
"""

import sys
from pathlib import Path

from deploy.app import run
from deploy.zenoh_client import BridgeAddress
from rover_ncp.core.console import Output

if __name__ == "__main__":
    _, _, robot, course, recording, period_s, _ = sys.argv
    address, period = BridgeAddress(robot), float(period_s)
    sys.exit(
        run(
            address,
            Output(True),
            policy="parking",
            course=course,
            record=Path(recording),
            period_s=period,
        )
    )
