"""What the pre-flight says of a robot that did not move as commanded."""

import math
import time
from datetime import date
from types import SimpleNamespace

import pytest

from deploy.check import Battery, Preflight
from deploy.drive.lease import NOT_ACCEPTED
from deploy.drive.measurements import NS
from rover_ncp.core.errors import SafetyStop
from rover_ncp.robot.description import load_description
from rover_ncp.wire.protocol import BaseReply, GateStatus


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


@pytest.mark.parametrize(
    ("stops", "tries"), [([NOT_ACCEPTED], 2), ([NOT_ACCEPTED, NOT_ACCEPTED], 2), (["bumper"], 1)]
)
def test_a_move_is_tried_once_more_when_the_gate_seemed_to_accept_nothing(monkeypatch, stops, tries):
    left, tried, requested = list(stops), [], []

    def command(self, velocity):
        tried.append(velocity)
        if left:
            raise SafetyStop(left.pop(0), "")
        return "moved"

    monkeypatch.setattr(Preflight, "_command", command)
    monkeypatch.setattr(Preflight, "_until", lambda self, condition, timeout_s: False)
    link = SimpleNamespace(request_motors=lambda name, unchecked: requested.append(unchecked))
    preflight = Preflight(link, None, None, None)
    if len(stops) == tries or stops == ["bumper"]:
        with pytest.raises(SafetyStop, match=stops[-1]):
            preflight._move((0.1, 0.0))
    else:
        assert preflight._move((0.1, 0.0)) == "moved"
    assert (len(tried), len(requested)) == (tries, tries - 1)


@pytest.mark.parametrize(
    ("volts", "ok", "words"),
    [
        (0.0, True, "the base reports no voltage"),
        (11.4, False, "11.4 V"),
        (11.6, True, "11.6 V"),
        (math.nan, False, "nan V"),
    ],
)
def test_voltage_of_zero_is_not_known_as_to_the_gate(volts, ok, words):
    battery = Battery()
    battery.voltage = volts
    link = SimpleNamespace(about_base=lambda: None)
    preflight = Preflight(link, None, SimpleNamespace(until=lambda *_: None), battery)
    preflight._until = lambda condition, timeout_s: condition()
    found, detail = preflight._check_battery()
    assert found is ok
    assert detail.startswith(words)


def test_the_check_keeps_its_lease_while_it_measures_and_prints_the_line_to_add(monkeypatch):
    states = ["unknown", *["running"] * 8, "measured"]
    replies = (BaseReply(model="mine", state=state, timeout_s=0.514) for state in states)
    requested = []

    def request(name, unchecked=False):
        requested.append((name, unchecked))

    link = SimpleNamespace(about_base=lambda measure=False: next(replies), request_motors=request)
    monkeypatch.setattr(Preflight, "_move", lambda self, velocity: None)
    monitor = SimpleNamespace(until=lambda condition, timeout_s: False)
    found, detail = Preflight(link, None, monitor, None)._check_base_timeout()
    assert found
    assert detail.endswith(f"measured_base_timeout_s: 0.52 # {date.today()}")
    assert requested == [("check", True)] * 9  # one for the move, and one at each look


@pytest.mark.parametrize(("decel", "ok"), [(1.0, False), (0.1, True)])
def test_a_robot_may_brake_as_slowly_as_its_description_says(monkeypatch, decel, ok):
    robot = load_description("turtlebot4")
    robot = robot.model_copy(update={"motion": robot.motion.model_copy(update={"decel": decel})})
    stood = SimpleNamespace(ref=SimpleNamespace(measured_ns=time.monotonic_ns() + round(1.4 * NS)))
    monkeypatch.setattr(Preflight, "_move", lambda self, velocity: None)
    monkeypatch.setattr(Preflight, "_until", lambda self, condition, timeout_s: True)
    found, words = Preflight(None, SimpleNamespace(newest=stood), None, None, robot)._check_silence()
    assert found is ok, words
