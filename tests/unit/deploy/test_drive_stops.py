"""Contacts in a drive, on the virtual clock before a real bridge and base."""

import pytest
from kit.virtual_drive import VirtualDrive, short_course

from deploy.view.recorded_drive import read_drive
from rover_ncp.course.scoring import Parked
from rover_ncp.wire.messages import bumpers

ANYWHERE = short_course(position_m=5.0, heading_rad=3.0, still_m=5.0, still_rad=3.0, still_s=0.1)
"""A rover parks wherever this course ends."""


def hold_for_a_moment(link):
    link.change_gate(held="stall")
    link.after, link.harm = link.after + 4, lambda: link.change_gate(held="")


@pytest.mark.parametrize(
    ("harm", "contact"),
    [
        (lambda link: None, None),
        (lambda link: link.change_gate(stops={"silence": 1}), None),
        (lambda link: link.change_gate(stops={"stall": 1}), "a motor is stalled"),
        (lambda link: link.change_gate(stops={"bumper": 1}), "a bumper is pressed"),
        (lambda link: link.put("bumpers", bumpers(0, 4)), "a bumper is pressed"),
        (hold_for_a_moment, "a motor is stalled"),
    ],
)
def test_drive_with_a_contact_is_never_parked(tmp_path, harm, contact):
    virtual = VirtualDrive(course=ANYWHERE, path=tmp_path / "run.mcap")
    virtual.link.harm = lambda: harm(virtual.link)
    result = virtual.run()
    parked = contact is None
    words = Parked.YES if parked else Parked.NO
    assert (result.exit_code, result.verdict, result.contact) == (int(not parked), words, contact)
    if contact:
        assert result.reason == f"touched an obstacle: {contact}"
    assert read_drive(virtual.path).timeline.judge()["estimated"].parked is parked


def test_page_of_a_drive_whose_first_tick_was_late_says_what_the_driver_says(tmp_path):
    virtual = VirtualDrive(course=ANYWHERE, path=tmp_path / "run.mcap")
    link, take = virtual.link, virtual.link.odometry.take

    def take_late(timeout_s=0.0):
        found = take(timeout_s)
        if found and link.requests and not link.sent:
            virtual.bridge.sleep(0.15)
        return found

    link.odometry.take = take_late
    assert virtual.run().verdict is Parked.YES
    assert read_drive(virtual.path).timeline.judge()["estimated"].parked
