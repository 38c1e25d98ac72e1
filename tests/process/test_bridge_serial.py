"""Serial lines, on pseudo-terminals: third-party Soar against the mock, ours against rates that differ."""

import json
import math
import subprocess
import sys
from contextlib import ExitStack

import pytest
from kit.bridge_bench import Driver, wait_for
from kit.paths import ROOT
from kit.serial_base import SerialBase

from sim.base.firmware import ClientState
from sim.park.live import Process


@pytest.mark.long
def test_soar_connects_drives_and_disconnects():
    with SerialBase() as base:
        peer = ROOT / "tests/kit/soar_peer.py"
        done = subprocess.run(
            [sys.executable, str(peer), base.port], capture_output=True, text=True, timeout=60, check=False
        )
        assert done.returncode == 0, done.stderr
        (line,) = [line for line in done.stdout.splitlines() if line.startswith("SEEN ")]
        seen = json.loads(line.removeprefix("SEEN "))
        wait_for(lambda: base.firmware.client is ClientState.WAITING)
        assert not base.firmware.unknown
        assert not base.firmware.bad_arguments
        true = base.rover.pose
    assert seen["config"]["SUBTYPE"] == "p3at-sh"
    assert seen["config"]["WATCHDOG"] == 2000
    assert seen["battery_dv"] == pytest.approx(127, abs=10)
    assert (seen["motors_before"], seen["motors_after"]) == (0, 0)
    x, y, _ = seen["straight"]
    assert (x, y) == (pytest.approx(true.x, abs=0.01), pytest.approx(true.y, abs=0.01))
    assert 0.2 < x < 0.45  # 0.2 m/s for 1.5 s, or what a loaded machine makes of them
    assert seen["turned"] == pytest.approx(true.theta, abs=0.01)
    assert math.radians(20) < seen["turned"] < math.radians(50)
    assert (seen["analogs"], len(seen["sonars"])) == (9, 8)


@pytest.fixture
def bridge_on(tmp_path):
    """Start a bridge as a process on a serial base."""
    with ExitStack() as running:

        def start(base):
            arguments = ["--base", f"serial/{base.port}#baudrate=9600", "--listen", "tcp/127.0.0.1:0"]
            process = running.enter_context(Process("bridge", arguments, tmp_path))
            return process, process.wait_for_line("ready zenoh=").split()[0]

        yield start


def test_a_bridge_on_a_serial_line_asks_for_a_faster_rate_and_drives(bridge_on):
    with SerialBase(strict=True) as base:
        assert base.firmware.baudrate == 9600
        process, zenoh = bridge_on(base)
        assert (base.firmware.baudrate, base.client_rate) == (38400, 38400)
        with Driver(zenoh) as driver:
            driver.start()
        process.stop()
        assert (base.firmware.client, base.firmware.baudrate) == (ClientState.WAITING, 9600)
    assert base.rates[:2] == [9600, 38400]
