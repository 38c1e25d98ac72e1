"""Run the safety matrix and write its figures into docs/safety.md: ``python tests/tools/safety_table.py``."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from faults.table import MATRIX

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "safety.md"
BEGIN, END = "<!-- measured: make safety -->\n", "<!-- end -->\n"


def table(found):
    """Return the rows as Markdown; what is measured includes the mock's own delay and braking."""
    yield "| layer | fault | stands after | allowed |"
    yield "|---|---|---:|---|"
    for row in MATRIX:
        measured = found[row.key]
        note = f" ({measured['note']})" if measured["note"] else ""
        yield (
            f"| {row.layer} | {row.fault}{note} | {measured['seconds']:.2f} s | "
            f"{row.allowed} + {measured['braking_s']:.2f} s braking |"
        )


def main():
    with tempfile.TemporaryDirectory() as folder:
        rows = Path(folder) / "rows.jsonl"
        environment = {**os.environ, "ROVER_NCP_SAFETY_ROWS": str(rows)}
        # All but the test of what is about to be written.
        matrix = ["-m", "pytest", "-q", "tests/system/test_safety_matrix.py", "-k", "not page"]
        code = subprocess.run([sys.executable, *matrix], cwd=ROOT, env=environment, check=False).returncode
        lines = rows.read_text().splitlines() if rows.exists() else []
    found = {line["row"]: line for line in map(json.loads, lines)}
    if code == 0:
        head, _, rest = PAGE.read_text().partition(BEGIN)
        _, _, tail = rest.partition(END)
        PAGE.write_text(head + BEGIN + "\n" + "\n".join(table(found)) + "\n\n" + END + tail)
    return code


if __name__ == "__main__":
    sys.exit(main())
