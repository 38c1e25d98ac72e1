"""The rows of the safety matrix as tests measure them.

Every row ends in ``docs/safety.md`` when ``python tests/tools/safety_table.py`` runs the matrix.
"""

import json
import os
from pathlib import Path

from paths import DATA

from sim.faults.measure import in_time

COURSE = DATA / "prompt_course.yaml"
WALL = COURSE.with_name("wall_course.yaml")
ROWS_FILE = os.environ.get("ROVER_NCP_SAFETY_ROWS")


def record(row, seconds, braking_s, late_s, note=""):
    """Hold a measured time to standstill against its row's bound, and note it."""
    found = {
        "row": row.key,
        "seconds": round(seconds, 2),
        "braking_s": round(braking_s, 2),
        "late_s": round(late_s, 3),
        "note": note,
    }
    if ROWS_FILE:
        with Path(ROWS_FILE).open("a") as file:
            file.write(json.dumps(found) + "\n")
    assert in_time(row, seconds, braking_s, late_s), found
