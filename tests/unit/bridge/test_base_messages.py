"""Base reports as ROS messages."""

import math
import struct
from dataclasses import replace

import pytest

from bridge import base_messages as ros
from bridge.base import BaseReport, LinkHealth
from bridge.gate.state import NO_CONTACT, GateState, Lease, Reason
from bridge.pioneer.odometry import ROBOTS
from rover_ncp.wire.key_table import spec
from rover_ncp.wire.messages import decode, read_odometry, text
from rover_ncp.wire.protocol import dump_json

ROBOT = ROBOTS["p3at-sh"]
STAMP = 1_700_000_000_123_456_789
STATE = BaseReport(
    x=1.0,
    y=-2.0,
    theta=7.0,  # more than a turn: the base counts on
    v=0.16,
    omega=-0.18,
    motors_on=True,
    bumpers=(0b10, 0b1),
    battery_v=12.5,
)
CERTAIN = ros.Variances((1e-6, 1e-6, 1e-6), (1e-6, 1e-6), 1e-6)


def sent(state, variances=CERTAIN):
    both = ros.each_report(state, ROBOT, STAMP, variances) | ros.each_second(state, ROBOT, STAMP)
    return {name: decode(spec(name).type, data) for name, data in both.items()}


def test_odometry_is_base_link_in_odom():
    message = sent(STATE)["odom"]
    assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
    sample = read_odometry(ros.each_report(STATE, ROBOT, STAMP, CERTAIN)["odom"])
    assert sample.stamp_ns == STAMP
    assert sample.velocity == (0.16, -0.18)
    assert sample.pose == pytest.approx((1.0, -2.0, 7.0 - math.tau))
    assert all(message.pose.covariance[7 * k] > 0.0 for k in range(6))


def test_echoes_lie_where_the_sonars_look():
    assert "sonar" not in sent(STATE)
    # Sonar 0 sits left and looks left, sonar 11 sits at the back and looks almost straight back.
    echoes = {0: 1.0, 11: 2.0, 3: 5.0, 99: 1.0, 4: 0.0}  # nothing heard, no such sonar, no range
    cloud = sent(replace(STATE, sonar=echoes))["sonar"]
    points = [struct.unpack_from("<3f", cloud.data.tobytes(), 12 * k) for k in range(cloud.width)]
    assert cloud.header.frame_id == "base_link"
    left, back = points
    assert left == pytest.approx((0.147, 1.136, 0.25), abs=1e-6)
    angle = math.radians(-170)
    assert back == pytest.approx((-0.241 + 2 * math.cos(angle), -0.027 + 2 * math.sin(angle), 0.25), abs=1e-6)


@pytest.mark.parametrize(("charging", "status"), [(None, 0), (False, 2), (True, 1)])
def test_bumpers_battery_and_charging_as_far_as_it_is_known(charging, status):
    messages = sent(replace(STATE, charging=charging))
    assert list(messages["bumpers"].data) == [0b10, 0b1]
    battery = messages["battery_state"]
    assert (battery.voltage, battery.present, battery.power_supply_status) == (12.5, True, status)


def test_the_longest_state_of_the_gate_fits_its_key():
    counts = dict.fromkeys(Reason, 2**40)
    state = GateState(
        lease=Lease(2**64 - 1, bytes(32), "ü" * 200, 0.0, 1.0, 2**64 - 1, NO_CONTACT),
        stop_reason="ü" * 200,
        dropped=counts,
        limited=counts,
        stops=counts,
    )
    assert len(text(dump_json(ros.gate_status(state)).decode())) <= spec("rover/gate").max_bytes


CLEAN, DAMAGED = LinkHealth(False, {"bad_checksums": 0}), LinkHealth(True, {"bad_checksums": 1})
OPEN, SILENT = GateState(held=None), GateState(held=Reason.SILENCE)


def levels(base, gate=OPEN, health=CLEAN):
    data = ros.diagnostics(base, gate, health, reconnects=2, hardware="p3at", stamp_ns=STAMP)
    message = decode(spec("diagnostics").type, data)
    assert {status.hardware_id for status in message.status} == {"p3at"}
    return {status.name.split(": ")[1]: (status.level, status.message) for status in message.status}


def test_diagnostics_name_the_problems():
    well = replace(STATE, bumpers=(0, 0))
    ill = replace(STATE, stop_pressed=True, stalled=(False, True), faults=8)
    ill_words = "STOP button pressed, stalled, bumper pressed, reports faults"
    healthy = {"link to the base": (0, "clean"), "base": (0, "fine"), "gate": (0, "open")}
    assert levels(well) == healthy
    assert levels(well, health=DAMAGED)["link to the base"] == (1, "messages are damaged or cannot be used")
    assert levels(ill, SILENT) == healthy | {"base": (2, ill_words), "gate": (1, "silence")}
    assert levels(None) == healthy | {"base": (2, "not connected")}
