"""The paper's experiments: tasks, controllers, searches, stored runs, and the claims that the runs test.

This folder is no part of the installed project. Run it at the top of a clone::

    python -m paper report
    python -m paper replay
    python -m paper run --budget quick --task parking
    python -m paper.bnn IN.bnn OUT.yaml
"""

import os
import sys

import typer

from rover_ncp.core.errors import RoverNcpError

# Read by numpy and scipy when they are loaded: for matrices as small as these, the threads of BLAS only wait.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def run_command_line(app: typer.Typer, name: str) -> None:
    """Run this process's command line and end the process; a user's mistake is one line on stderr."""
    try:
        app(prog_name=f"python -m {name}")
    except RoverNcpError as error:
        print(f"{name}: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
