"""``python -m rover_ncp``: the same as the ``rover-ncp`` script, for where scripts are not on the path."""

from rover_ncp.shell import main

main()
