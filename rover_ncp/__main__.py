"""``python -m rover_ncp``: the same as the ``rover-ncp`` script, for where scripts are not on the path."""

import sys

if not sys.flags.safe_path:
    # The current folder, which may hold a sim/ or a scipy.py of the user's own.
    del sys.path[0]

from rover_ncp.cli import main

sys.exit(main())
