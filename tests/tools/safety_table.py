"""Run both safety matrices and write their figures into docs/measured, for docs/safety_matrix.md."""

import csv
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from faults.table import MATRIX, ROS2_ROWS, ROWS

ROOT = Path(__file__).parents[2]
MEASURED = ROOT / "docs" / "measured"


def pioneer_table(lines):
    """Yield the Pioneer's head and rows; what is measured includes the mock's own delay and braking."""
    found = {line["row"]: line for line in lines}
    yield "layer", "fault", "standstill after", "allowed"
    for row in MATRIX:
        measured = found[row.key]
        note = f" ({measured['note']})" if measured["note"] else ""
        allowed = f"{measured['bound_s']:g} s + {measured['braking_s']:.2f} s braking"
        yield row.layer, row.fault + note, f"{measured['seconds']:.2f} s", allowed


def ros2_table(lines):
    """Yield head and rows of the ROS 2 robot; what is allowed includes its delay and braking."""
    found = {(line["row"], line["form"]): line for line in lines}
    yield "layer", "fault", "standstill after (ros2dds)", "standstill after (rmw_zenoh)", "allowed"
    for key in dict.fromkeys(row.key for row in (*MATRIX, *ROS2_ROWS) if (row.key, "ros2dds") in found):
        row, times = ROWS[key], [found.get((key, form)) for form in ("ros2dds", "rmw_zenoh")]
        words = (f"{time['seconds']:.2f} s" if time else "" for time in times)
        yield row.layer, row.fault, *words, f"{times[0]['bound_s'] + times[0]['braking_s']:.2f} s"


def write_table(path, rows):
    """Write a table as CSV."""
    with path.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def main():
    code = 0
    for test, name, table in (
        ("test_safety_matrix.py", "pioneer", pioneer_table),
        ("test_safety_matrix_ros2.py", "ros2", ros2_table),
    ):
        with tempfile.TemporaryDirectory() as folder:
            rows = Path(folder) / "rows.jsonl"
            environment = {**os.environ, "ROVER_NCP_SAFETY_ROWS": str(rows)}
            matrix = ["-m", "pytest", "-q", f"tests/system/{test}", "-m", "timed"]
            done = subprocess.run([sys.executable, *matrix], cwd=ROOT, env=environment, check=False)
            lines = [json.loads(line) for line in rows.read_text().splitlines()] if rows.exists() else []
        if done.returncode == 0:
            write_table(MEASURED / f"{name}.csv", table(lines))
        code = code or done.returncode
    return code


if __name__ == "__main__":
    sys.exit(main())
