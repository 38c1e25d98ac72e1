"""Updates of a drive for its live page, and the page that ``watch`` serves."""

import json
from html import unescape

import pytest
from kit.recorded_drives import BEGAN_NS, TICK_NS, state

from deploy.view.feed import Cursor
from rover_ncp.wire.messages import read_text
from rover_ncp.wire.protocol import DriverStatus, parse_json


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


def test_another_driver_that_is_refused_does_not_end_the_drive(short, feed):
    until, cursor = BEGAN_NS + 20 * TICK_NS + TICK_NS // 2, Cursor()
    for message in short.messages:
        if message.log_ns <= until:
            feed.take(message)
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


def named(messages, **names):
    """Return the messages with other names in the driver's status."""
    for message in messages:
        if message.topic == "rover/status":
            status = parse_json(DriverStatus, read_text(message.data))
            message = state(status.model_copy(update=names), message.log_ns)  # noqa: PLW2901
        yield message


def test_drive_of_another_course_has_no_currents(short, feed):
    for message in named(short.messages, policy="parking", course="bay"):
        feed.take(message)
    found = feed.updates(Cursor())
    assert found["elsewhere"]
    assert unescape(found["html"]["subline"]).count("start watch with --policy and --course") == 1
    ticks = found["ticks"]
    assert {value for name in ("currents", "pulls") for column in ticks[name] for value in column} == {None}
    assert ticks["potentials"][3] == pytest.approx(short.run.potentials[:, 3], abs=0.01)
    assert "start" not in {event["kind"] for event in found["events"]}
