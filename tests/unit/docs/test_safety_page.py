"""The measured tables of the safety matrix, and the tool that writes them."""

import csv

import pytest
import safety_table
from faults.table import MATRIX, ROS2_KEYS, ROWS
from kit.paths import ROOT


@pytest.mark.parametrize(
    ("table", "rows"),
    [("pioneer", MATRIX), ("ros2", [ROWS[key] for key in ROS2_KEYS])],
)
def test_the_table_has_every_row(table, rows):
    with (ROOT / "docs" / "measured" / f"{table}.csv").open(newline="") as file:
        lines = [*csv.DictReader(file)]
    for row, line in zip(rows, lines, strict=True):
        assert line["layer"] == row.layer
        assert line["fault"].startswith(row.fault)
        assert line["allowed"]


def test_a_measured_row_has_its_bound():
    line = {"seconds": 0.5, "bound_s": 2.0, "braking_s": 0.25, "note": "9 a second"}
    _, first, *_ = safety_table.pioneer_table([line | {"row": row.key} for row in MATRIX])
    assert first == (MATRIX[0].layer, f"{MATRIX[0].fault} (9 a second)", "0.50 s", "2 s + 0.25 s braking")


def test_a_row_measured_in_one_form_leaves_the_other_empty():
    key = ROS2_KEYS[0]
    line = {"row": key, "form": "ros2dds", "seconds": 0.13, "bound_s": 0.5, "braking_s": 0.12}
    _, row = safety_table.ros2_table([line])
    assert row == (ROWS[key].layer, ROWS[key].fault, "0.13 s", "", "0.62 s")
