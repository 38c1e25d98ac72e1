"""A drive during which the base reports a contact is not parked, wherever it ends."""

import pytest

from deploy.view.recorded_drive import read_drive
from rover_ncp.wire.messages import bumpers

ANYWHERE = """
name: anywhere
start_signal_s: 0.3
horizon_s: 2.0
checkpoints: [{t: 2.0, x: 0.0, y: 0.0, theta: 0.0}]
parked: {position_m: 5.0, heading_rad: 3.0, still_m: 5.0, still_rad: 3.0, still_s: 0.1}
"""


def press(bridge):
    bridge.session.put(bridge._key("bumpers"), bumpers(0, 4))


def count(reason):
    """Let the gate count a command that it cut off for this reason."""

    def cut_off(bridge):
        bridge.gate = bridge.gate.model_copy(update={"stops": {reason: 1}})

    return cut_off


def hold(bridge):
    bridge.gate = bridge.gate.model_copy(update={"held": "stall"})
    bridge.after_commands(len(bridge.commands) + 4, lambda: release(bridge))


def release(bridge):
    bridge.gate = bridge.gate.model_copy(update={"held": ""})


@pytest.mark.parametrize(
    ("harm", "contact"),
    [
        (lambda bridge: None, None),
        (count("silence"), None),
        (count("stall"), "a motor is stalled"),
        (count("bumper"), "a bumper is pressed"),
        (press, "a bumper is pressed"),
        (hold, "a motor is stalled"),
    ],
)
def test_a_contact_is_never_parked(bridge, drive, tmp_path, harm, contact):
    course = tmp_path / "anywhere.yaml"
    course.write_text(ANYWHERE)
    bridge.after_commands(6, lambda: harm(bridge))
    code, result = drive(course=str(course))
    assert (code, result["parked"], result["contact"]) == (int(contact is not None), contact is None, contact)
    if contact:
        assert result["reason"] == f"touched an obstacle: {contact}"
    estimated = read_drive(tmp_path / "run.mcap").timeline.judge()["estimated"]
    assert estimated.parked is (contact is None)


def test_a_bumper_that_was_pressed_before_the_lease_does_not_count(bridge, drive, tmp_path):
    course = tmp_path / "anywhere.yaml"
    course.write_text(ANYWHERE)
    bridge.gate = bridge.gate.model_copy(update={"stops": {"bumper": 3}})
    press(bridge)
    assert drive(course=str(course))[1]["parked"]
