"""Run the safety matrix and write what it measured into docs/safety.md: ``python tests/safety_table.py``."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "safety.md"
BEGIN, END = "<!-- measured: make safety -->\n", "<!-- end -->\n"
REQUIREMENT = {0.5: "0.5 s", 2.0: "2 s", 2.5: "2 s + 0.5 s"}


def table(rows):
    """Return the rows as Markdown; what is measured includes the mock's own delay and braking."""
    yield "| layer | fault | stands after | allowed |"
    yield "|---|---|---:|---|"
    for row in rows:
        bound, braking = row["bound_s"], row["braking_s"]
        yield (
            f"| {row['layer']} | {row['fault']} | {row['seconds']:.2f} s | "
            f"{REQUIREMENT[bound]} + {braking:.2f} s braking |"
        )


def main():
    with tempfile.TemporaryDirectory() as folder:
        found = Path(folder) / "rows.jsonl"
        environment = {**os.environ, "ROVER_NCP_SAFETY_ROWS": str(found)}
        matrix = ["-m", "pytest", "-q", "tests/test_safety_matrix.py"]
        code = subprocess.run([sys.executable, *matrix], cwd=ROOT, env=environment, check=False).returncode
        rows = [json.loads(line) for line in found.read_text().splitlines()] if found.exists() else []
    if code == 0:
        head, _, rest = PAGE.read_text().partition(BEGIN)
        _, _, tail = rest.partition(END)
        PAGE.write_text(head + BEGIN + "\n" + "\n".join(table(rows)) + "\n\n" + END + tail)
    return code


if __name__ == "__main__":
    sys.exit(main())
