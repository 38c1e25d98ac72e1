"""Lines to the base that fall silent but stay open, with bridge, relay and mock as real processes."""

import signal
import time

import pytest
from faults.proxy import Proxy
from kit.bridge_bench import Driver, wait_for

from sim.live.live_run import LiveRun

RECOVERY_S = 5.0
"""The base is there again at the latest so long after it answers again."""


class RelayedRun(LiveRun):
    """The bridge reaches the mock through ``relay``."""

    def start_mock(self):
        base = super().start_mock()
        self.relay = self.start_process(lambda: Proxy(base, self.folder, "line"))
        return self.relay.address


def reopenings(rig):
    """Return the bridge's log lines about a line that does not answer."""
    return [line for line in (rig.folder / "bridge.log").read_text().splitlines() if "reopens" in line]


@pytest.mark.long
def test_a_connection_that_falls_silent_is_replaced_and_the_log_says_so_once(tmp_path):
    with RelayedRun(tmp_path) as rig, Driver(rig.robot) as driver:
        driver.start()
        rig.relay.tell("silence")
        began_s = time.monotonic()
        wait_for(lambda: driver.gate.held == "no-base")
        wait_for(lambda: driver.gate.held != "no-base", 15.0)
        assert time.monotonic() - began_s < RECOVERY_S
        (line,) = reopenings(rig)
        assert line.startswith(f"tcp/{rig.base}: no packet from the base since it was lost; ")
        driver.start()
        done = rig.bridge.stop()
    assert (done.code, done.result["reconnects"]) == (0, 1)


@pytest.mark.long
def test_a_base_that_stops_for_a_while_is_there_again_soon_after(tmp_path):
    with LiveRun(tmp_path) as rig, Driver(rig.robot) as driver:
        driver.start()
        rig.mock.send_signal(signal.SIGSTOP)
        try:
            wait_for(lambda: driver.gate.held == "no-base")
            time.sleep(9.5)
            assert driver.motors().reason == "no-base"  # the loop goes on while its thread opens lines
        finally:
            rig.mock.send_signal(signal.SIGCONT)
        back_s = time.monotonic()
        wait_for(lambda: driver.gate.held != "no-base", 15.0)
        assert time.monotonic() - back_s < RECOVERY_S
        assert len(reopenings(rig)) == 1
        driver.start()
