"""What the pre-flight says of a robot that did not move as commanded."""

from types import SimpleNamespace

from deploy.preflight.preflight import Preflight
from rover_ncp.core.protocol import GateStatus


def said(after):
    """The words on a gate's status, whose earlier one had a stop and dropped commands already."""
    before = GateStatus(stops={"odometry": 1}, dropped={"stale": 3})
    return Preflight._gate_since(SimpleNamespace(_link=SimpleNamespace(gate=after)), before)


def test_a_stop_of_the_gate_that_is_over_is_named():
    over = GateStatus(stops={"odometry": 1, "silence": 1}, dropped={"stale": 3})
    assert said(over) == "the gate stopped the robot for a moment: silence"


def test_a_stop_that_holds_is_named_once():
    held = GateStatus(stops={"odometry": 2}, dropped={"stale": 3, "odometry": 4}, held="odometry")
    assert said(held) == "the gate stopped the robot: odometry"
