"""Entry point of the ``rover-ncp`` script: signals are handled before anything large is imported."""

import os
import sys

try:
    from rover_ncp.core.interruption import INTERRUPTED, handle_signals, ignore_signals, is_interruption
except KeyboardInterrupt:  # Python's own handler, which would print a traceback
    os._exit(130)


def main() -> None:
    """Run the command line of this process and end the process."""
    code = INTERRUPTED
    try:
        handle_signals()
        from rover_ncp.cli import main as run_command_line

        code = run_command_line()
    except (KeyboardInterrupt, Exception) as error:
        if not is_interruption(error):
            raise
        ignore_signals()
        from rover_ncp.cli import interrupted

        code = interrupted(sys.argv[1:])
    ignore_signals()
    sys.exit(code)
