"""Updates of a drive for its live page, and the page that ``watch`` serves."""

import json
from base64 import b64decode
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from kit.recorded_drives import BEGAN_NS, TICK_NS, state

from deploy.view import server
from deploy.view.feed import Cursor, Feed
from deploy.zenoh_client import BridgeAddress
from rover_ncp.core.console import Output
from rover_ncp.core.errors import NoBridge
from rover_ncp.course.course import load_course
from rover_ncp.course.scoring import Parked
from rover_ncp.course.slowdown import slowed
from rover_ncp.recording.recording import Recorded
from rover_ncp.robot.description import load_description
from rover_ncp.wire import messages
from rover_ncp.wire.cdr import encode
from rover_ncp.wire.key_table import TAG_VIEW, spec
from rover_ncp.wire.messages import read_text
from rover_ncp.wire.protocol import DriverStatus, GateStatus, parse_json


def joined(parts):
    """Put the columns of several pieces of updates together, as the page does."""
    whole = {"t": [], "x": [], "potentials": [], "setpoints": [], "odometry": []}
    for updates in parts:
        if ticks := updates.get("ticks"):
            whole["t"] += ticks["t"]
            whole["x"] += ticks["x"]
            whole["potentials"] += ticks["potentials"][3]
        whole["setpoints"] += updates.get("setpoints", {}).get("v", [])
        whole["odometry"] += updates.get("odometry", {}).get("x", [])
    return whole


def test_updates_in_pieces_are_the_whole(short, feed):
    pieces, cursor = [], Cursor()
    for number, message in enumerate(short.messages):
        feed.take(message)
        if number % 7 == 0:
            pieces.append(json.loads(json.dumps(feed.updates(cursor), allow_nan=False)))
    pieces.append(feed.updates(cursor))
    whole, once = joined(pieces), joined([feed.updates(Cursor())])
    assert whole == once
    assert whole["x"] == pytest.approx(short.run.poses[:-1, 0], abs=1e-4)
    assert whole["potentials"] == pytest.approx(short.run.potentials[:, 3], abs=0.01)
    assert [piece["reset"] for piece in pieces].count(True) == 1
    assert pieces[-1]["status"]["state"] == "ended"


def test_view_of_tags_is_sent_once_to_each_viewer_and_survives_a_drive(short, feed):
    first, second = Cursor(), Cursor()
    for jpeg in (b"one", b"two"):
        row = spec(TAG_VIEW)
        data = encode(row.type, format="jpeg", data=np.frombuffer(jpeg, np.uint8))
        feed.take(Recorded(row.name, row.type, data, 1, 1))
        assert b64decode(feed.updates(first)["view"]) == jpeg
    assert "view" not in feed.updates(first)
    for message in short.messages:
        feed.take(message)
    assert b64decode(feed.updates(second)["view"]) == b"two"


def test_a_new_drive_begins_anew(short, feed):
    received, cursor = short.messages, Cursor()
    for message in received:
        feed.take(message)
    assert feed.updates(cursor)["ticks"]["t"]
    after = received[-1].log_ns + 10**9
    feed.take(state(DriverStatus(state="armed", drive="second"), after))
    fresh = feed.updates(cursor)
    assert fresh["reset"] is True
    assert "ticks" not in fresh
    assert [event["text"] for event in fresh["events"]] == []
    for message in named(received, drive="second"):
        feed.take(message)
    assert len(feed.updates(cursor)["ticks"]["t"]) == short.course.ticks


def killed(short, feed, tick=20):
    """Take a drive up to a tick, after which its driver sends no more; return the time of that tick."""
    until = BEGAN_NS + tick * TICK_NS + TICK_NS // 2
    for message in short.messages:
        if message.log_ns <= until:
            feed.take(message)
    return until


def later(messages, by_ns, **leases):
    """Return messages at a later time; a held lease has the number ``lease``."""
    for message in messages:
        moved = replace(message, log_ns=message.log_ns + by_ns, publish_ns=message.publish_ns + by_ns)
        if message.topic == "rover/gate":
            gate = parse_json(GateStatus, read_text(message.data))
            moved = state(gate.model_copy(update=leases if gate.lease else {}), moved.log_ns)
        yield moved


@pytest.mark.parametrize("joined_at", [0, 5])
def test_drive_after_a_killed_driver_begins_anew(short, feed, joined_at):
    """``joined_at`` is the last tick of the second drive that does not arrive here, if it is not 0."""
    until, cursor = killed(short, feed), Cursor()
    feed.take(state(GateStatus(lease=1, held="bumper"), until))
    assert len(feed.updates(cursor)["ticks"]["t"]) == 21
    missed = BEGAN_NS + joined_at * TICK_NS if joined_at else 0
    second = [message for message in short.messages if message.log_ns > missed]
    for message in named(later(second, 600 * TICK_NS, lease=2), drive="second"):
        feed.take(message)
    found = feed.updates(cursor)
    assert found["reset"] is True
    # The first tick that arrives precedes the status that names its drive.
    count = short.course.ticks - (joined_at + 1 if joined_at else 0)
    assert found["ticks"]["t"] == pytest.approx([0.1 * tick for tick in range(count)])
    assert not feed._timeline.touched
    if not joined_at:
        alone = Feed(short.policy, short.course)
        for message in short.messages:
            alone.take(message)
        assert found["html"]["summary"] == alone.updates(Cursor())["html"]["summary"]


def test_another_driver_that_is_refused_does_not_end_the_drive(short, feed):
    until, cursor = killed(short, feed), Cursor()
    feed.updates(cursor)
    feed.take(state(DriverStatus(state="armed", drive="another"), until))
    assert feed.updates(cursor)["status"]["state"] == "driving"
    feed.take(state(DriverStatus(state="fault", drive="another"), until))
    for message in short.messages:
        if message.log_ns > until:
            feed.take(message)
    found = feed.updates(cursor)
    assert found["reset"] is False
    assert len(found["ticks"]["t"]) == short.course.ticks - 21


def test_rows_after_a_killed_driver_cost_no_memory(short, feed):
    until = killed(short, feed)
    odometry = next(message for message in short.messages if message.topic == "odom")
    voltage = next(message for message in short.messages if message.topic == "battery_state")
    for number in range(1000):
        for message in (odometry, voltage):
            feed.take(replace(message, log_ns=until + number * TICK_NS))
    timeline = feed._timeline
    assert 50 <= len(timeline.odometry) - 20 <= 55
    assert len(timeline.voltages) <= 55


@pytest.mark.parametrize(("model", "corners"), [("p3at-sh", 5), ("turtlebot3-burger", 5), ("turtlebot4", 37)])
def test_the_page_draws_the_robots_own_outline_and_the_course_at_its_speed(monkeypatch, model, corners):
    def unreachable(address, take):
        raise NoBridge

    drawn = []
    monkeypatch.setattr(server, "watch_page", lambda *parts: drawn.extend(parts[-2:]))
    monkeypatch.setattr(server, "Viewer", unreachable)
    with pytest.raises(NoBridge):
        server.run(BridgeAddress("tcp/127.0.0.1:9"), "parking", "parking", 0, Output(False), model=model)
    course, outline = drawn
    assert len(outline) == corners
    assert course == slowed(load_course("parking"), load_description(model))[0]


def test_waiting_for_a_drive_costs_no_memory(short, feed):
    sample = next(message for message in short.messages if message.topic == "odom")
    voltage = next(message for message in short.messages if message.topic == "battery_state")
    for _ in range(1000):
        feed.take(sample)
        feed.take(voltage)
    assert len(feed._timeline.odometry) <= 50
    assert len(feed._timeline.voltages) <= 50


def test_neurons_of_another_policy_are_noticed(feed):
    feed.take(
        Recorded("rover/neurons", "std_msgs/msg/Float64MultiArray", messages.neurons([0.0], ["X"]), 1, 1)
    )
    assert "neurons are not those of this page's policy" in unescape(
        feed.updates(Cursor())["html"]["subline"]
    )


def named(messages, *states, **names):
    """Return the messages with other names in the driver's status; ``states`` are those while it drives."""
    for message in messages:
        if message.topic != "rover/status":
            yield message
            continue
        status = parse_json(DriverStatus, read_text(message.data))
        if status.state == "driving" and states:
            names["state"] = states[min(status.tick // 10, len(states) - 1)]
        else:
            names.pop("state", None)
        yield state(status.model_copy(update=names), message.log_ns)


@pytest.mark.parametrize(
    ("states", "names", "note"),
    [
        ([], {"policy": "course", "course": "short"}, "start watch with --policy and --course"),
        ([], {"policy": "parking", "course": "bay"}, "start watch with --policy and --course"),
        (
            ["NAV_TO_STAGING_POSE, try 1 of 3", "CONTROLLING, try 1 of 3"],
            {"policy": "dock", "course": "home"},
            "a docking has two policies",
        ),
        (["CONTROLLING, try 1 of 3"], {}, "a docking has two policies"),
    ],
)
def test_drive_of_another_policy_or_course_has_no_currents(short, feed, states, names, note):
    for message in named(short.messages, *states, **names):
        feed.take(message)
    found = feed.updates(Cursor())
    assert unescape(found["html"]["subline"]).count(note) == 1
    assert "<dt>Ended as</dt><dd>ended</dd>" in found["html"]["summary"]
    ticks = found["ticks"]
    assert {value for name in ("currents", "pulls") for column in ticks[name] for value in column} == {None}
    assert ticks["potentials"][3] == pytest.approx(short.run.potentials[:, 3], abs=0.01)
    assert "start" not in {event["kind"] for event in found["events"]}


@pytest.mark.parametrize("refused_before", [False, True])
def test_drive_of_the_pages_own_policy_and_course_has_currents(short, feed, refused_before):
    own = {"policy": short.policy.circuit.name, "course": short.course.name}
    if refused_before:  # a driver of another policy, which sends no last status
        feed.take(state(DriverStatus(state="armed", drive="0", policy="another", course="bay"), 1))
    for message in named(short.messages, **own):
        feed.take(message)
    found = feed.updates(Cursor())
    assert "start watch with" not in found["html"]["subline"]
    assert None not in found["ticks"]["pulls"][0]
    assert "start" in {event["kind"] for event in found["events"]}


def test_the_live_page_shows_an_uncertain_verdict(feed):
    status = DriverStatus(state=Parked.UNCERTAIN, reason="with a probability of 80 %")
    feed.take(state(status, 1))
    assert '"doubt">parked, uncertain<' in feed.updates(Cursor())["html"]["title"]
