"""The measured tables of the safety page."""

import pytest
from faults.table import CHECKS, MATRIX, ROS2_KEYS, ROWS
from kit.paths import ROOT

PAGE = (ROOT / "docs" / "safety.md").read_text()


@pytest.mark.parametrize(
    ("table", "rows"),
    [("make safety", MATRIX), ("make safety, ROS 2", [ROWS[key] for key in (*ROS2_KEYS, *CHECKS)])],
)
def test_the_page_shows_every_row(table, rows):
    measured = PAGE.partition(f"<!-- measured: {table} -->")[2].partition("<!-- end -->")[0]
    lines = [line for line in measured.splitlines() if line.startswith("| ")]
    for row, line in zip(rows, lines[1:], strict=True):
        assert line.startswith(f"| {row.layer} | {row.fault}"), line
