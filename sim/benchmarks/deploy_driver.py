"""``rover-ncp deploy`` with ticks of another length, which is for the benchmark alone.

Run as ``python -m sim.benchmarks.deploy_driver deploy ROBOT COURSE RECORDING PERIOD_S --json``.
"""

import sys
from pathlib import Path

from deploy.app import Options, run
from rover_ncp.core.console import Output

if __name__ == "__main__":
    _, _, robot, course, recording, period_s, _ = sys.argv
    options = Options(robot, "parking", course, Path(recording), None, False, "", None)
    sys.exit(run(options, Output(True), float(period_s)))
