"""The benchmark of the driver's delays drives real processes."""

import os
import subprocess
import sys

import pytest
from kit.paths import ROOT

pytestmark = [pytest.mark.long, pytest.mark.timed]


def test_every_rate_is_measured():
    command = [sys.executable, "-m", "benchmarks.deploy", "--seconds", "3"]
    rows = subprocess.run(
        command,
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": "tests"},
        capture_output=True,
        text=True,
        check=True,
        timeout=280,
    ).stdout
    rates = [line.split() for line in rows.splitlines() if " Hz " in line]
    assert [rate[0] for rate in rates] == ["10", "50", "100"]
    assert all(float(rate[2]) > 0.0 and int(rate[5]) >= 20 for rate in rates)
