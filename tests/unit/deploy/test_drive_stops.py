"""Every reason for which a drive stops, on the virtual clock before a real bridge and base."""

import pytest
from kit.virtual_drive import VirtualDrive, short_course

from bridge.base import Lost
from deploy.drive.measurements import Measurements
from deploy.drive.safety_monitor import SafetyMonitor
from deploy.view.recorded_drive import read_drive
from rover_ncp.core.errors import SafetyStop
from rover_ncp.core.geometry import STANDSTILL
from rover_ncp.course.scoring import Parked
from rover_ncp.wire.messages import bumpers
from rover_ncp.wire.protocol import CommandTag, Signed, StopRequest, dump_json


@pytest.fixture
def virtual():
    return VirtualDrive()


def drop_as_stale(link):
    """Have the gate drop each further command, which is signed as one of a second ago."""

    def tag(data, sequence):
        tag = CommandTag(link.lease.number, sequence, link.bridge.now_ns - 10**9)
        return tag.sign(link.lease._secret, Signed.COMMAND, "cmd_vel", data)

    link.tag = tag


@pytest.mark.parametrize(
    ("harm", "reason"),
    [
        (drop_as_stale, "dropped since then: stale "),
        (lambda link: link.change.update({"rover/gate": lambda data: None}), "no dropped command"),
    ],
)
def test_driver_whose_commands_are_not_accepted_stops_within_half_a_second(virtual, harm, reason):
    link = virtual.link
    link.harm = lambda: harm(link)
    result = virtual.run()
    assert (result.exit_code, result.stopped_by) == (4, "not-accepted")
    assert reason in result.reason
    refused_ns = link.sent_ns[link.after]
    assert (link.released_ns - refused_ns) * 1e-9 < 0.5
    assert virtual.stands()


def test_interruption_stops_the_rover_first(virtual):
    virtual.interrupted = lambda: len(virtual.link.sent) >= 6
    result = virtual.run()
    assert (result.exit_code, result.reason, result.ticks) == (130, "interrupted", 6)
    assert result.words.splitlines()[0] == "interrupted; the rover was stopped"
    assert virtual.link.sent[-1] == STANDSTILL
    assert virtual.stands()


@pytest.mark.parametrize(
    ("requests", "expected"),
    [
        ([{"reason": "Anna"}, {"release": True}], "stopped by Anna"),
        ([{}], "stopped by a client that gave no name"),
    ],
)
def test_a_requested_stop_names_who_requested_it_also_once_it_is_released(virtual, requests, expected):
    def stop():
        for fields in requests:
            virtual.bridge.query("rover/stop", dump_json(StopRequest(**fields)))

    virtual.link.harm = stop
    assert virtual.run().reason == expected


def test_a_lost_base_is_named_as_the_bridge_knows_it(virtual):
    bridge, reason = virtual.bridge, "/teleop publishes /cmd_vel too"
    virtual.link.harm = lambda: bridge._node._handle([Lost(reason)], bridge.monotonic())
    words = f"the base is not connected: {reason}"
    assert virtual.run().reason == f"stopped by no-base: {words}"
    with pytest.raises(SafetyStop, match=words):
        virtual.link.request_motors("again")


def test_a_lease_that_lapsed_has_words(virtual):
    virtual.bridge.sleep(3.0)
    monitor = SafetyMonitor(virtual.link, Measurements(virtual.link), lambda: False, clock=virtual.bridge)
    monitor.wait()
    virtual.link.request_motors("test")
    monitor.granted()
    with pytest.raises(SafetyStop) as stop:
        monitor.until(lambda: monitor._measurements.odometry(0) and monitor.check(), 2.0)
    assert str(stop.value) == "stopped by lease-lapsed: no command arrived for longer than a lease lasts"


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


def test_bumper_that_was_pressed_before_the_lease_does_not_count():
    virtual = VirtualDrive(course=ANYWHERE)
    virtual.link.change_gate(stops={"bumper": 3})
    virtual.link.put("bumpers", bumpers(0, 4))
    assert virtual.run().verdict is Parked.YES
