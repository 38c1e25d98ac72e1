"""The words of a stop, on virtual time."""

from types import SimpleNamespace

import pytest

from deploy.drive.measurements import NS
from deploy.drive.safety_monitor import SafetyMonitor
from rover_ncp.core.errors import SafetyStop


def stop_after(pauses_s, fresh=False):
    """Check after each pause, with odometry of time 0 or ``fresh`` one; return the words of the stop."""
    now_ns = [0]
    clock = SimpleNamespace(monotonic_ns=lambda: now_ns[0])
    link = SimpleNamespace(bridge_alive=True)
    measurements = SimpleNamespace(newest=SimpleNamespace(ref=SimpleNamespace(measured_ns=0)))
    monitor = SafetyMonitor(link, measurements, lambda: False, clock=clock)
    monitor.check()
    with pytest.raises(SafetyStop, match="odometry-age") as stop:
        for pause_s in pauses_s:
            now_ns[0] += round(pause_s * NS)
            if fresh:
                measurements.newest = SimpleNamespace(ref=SimpleNamespace(measured_ns=now_ns[0]))
            monitor.check()
    return str(stop.value)


def test_old_odometry_is_not_blamed_on_the_robot_while_the_driver_did_not_run():
    assert "; the driver process was stalled for 0.31 s" in stop_after([0.02, 0.31, 0.1])
    assert "stalled" not in stop_after([0.02] * 30)


def test_a_driver_that_did_not_run_stops_also_when_it_finds_fresh_odometry():
    """After a pause it is a race which thread runs first, the one that receives or the one that checks."""
    words = stop_after([0.3, 0.35, 0.41], fresh=True)
    assert words.endswith("(limit 0.4 s); the driver process was stalled for 0.41 s")
