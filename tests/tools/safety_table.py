"""Run both safety matrices and write their figures into docs/safety.md."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from faults.table import MATRIX, ROS2_ROWS, ROWS

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "safety.md"
END = "<!-- end -->\n"
PIONEER, ROS2 = "<!-- measured: make safety -->\n", "<!-- measured: make safety, ROS 2 -->\n"


def pioneer_table(lines):
    """Yield the Pioneer's rows as Markdown; what is measured includes the mock's own delay and braking."""
    found = {line["row"]: line for line in lines}
    yield "| layer | fault | stands after | allowed |"
    yield "|---|---|---:|---|"
    for row in MATRIX:
        measured = found[row.key]
        note = f" ({measured['note']})" if measured["note"] else ""
        yield (
            f"| {row.layer} | {row.fault}{note} | {measured['seconds']:.2f} s | "
            f"{measured['bound_s']:g} s + {measured['braking_s']:.2f} s braking |"
        )


def ros2_table(lines):
    """Yield the rows of the ROS 2 robot as Markdown; what is allowed includes its delay and braking."""
    found = {(line["row"], line["form"]): line for line in lines}
    yield "| layer | fault | stands after (ros2dds) | (rmw_zenoh) | allowed |"
    yield "|---|---|---:|---:|---:|"
    for key in dict.fromkeys(row.key for row in (*MATRIX, *ROS2_ROWS) if (row.key, "ros2dds") in found):
        row, times = ROWS[key], [found.get((key, form)) for form in ("ros2dds", "rmw_zenoh")]
        words = " | ".join(f"{time['seconds']:.2f} s" if time else "" for time in times)
        allowed_s = times[0]["bound_s"] + times[0]["braking_s"]
        yield f"| {row.layer} | {row.fault} | {words} | {allowed_s:.2f} s |"


def main():
    code = 0
    for test, begin, table in (
        ("test_safety_matrix.py", PIONEER, pioneer_table),
        ("test_safety_matrix_ros2.py", ROS2, ros2_table),
    ):
        with tempfile.TemporaryDirectory() as folder:
            rows = Path(folder) / "rows.jsonl"
            environment = {**os.environ, "ROVER_NCP_SAFETY_ROWS": str(rows)}
            matrix = ["-m", "pytest", "-q", f"tests/system/{test}", "-m", "timed"]
            done = subprocess.run([sys.executable, *matrix], cwd=ROOT, env=environment, check=False)
            lines = [json.loads(line) for line in rows.read_text().splitlines()] if rows.exists() else []
        if done.returncode == 0:
            head, _, rest = PAGE.read_text().partition(begin)
            _, _, tail = rest.partition(END)
            PAGE.write_text(head + begin + "\n" + "\n".join(table(lines)) + "\n\n" + END + tail)
        code = code or done.returncode
    return code


if __name__ == "__main__":
    sys.exit(main())
