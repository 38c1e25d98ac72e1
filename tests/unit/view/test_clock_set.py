"""The wall clock of a driver is set during its drive: each tool shows the same drive as without that."""

import functools
import json
from dataclasses import replace

import pytest
from kit.recorded_drives import BEGAN_NS, TICK_NS, drive_messages

from deploy.drive.records import COURSE_FILE, POLICY_FILE, TICKS_TOPIC
from deploy.view.page_data import columns
from deploy.view.recorded_drive import facts, read_drive
from rover_ncp.circuit.policy_file import load_policy, policy_to_yaml
from rover_ncp.core.config import dump_yaml
from rover_ncp.course.course import load_course
from rover_ncp.recording import recording
from rover_ncp.recording.arrays import read_arrays
from rover_ncp.recording.recording import Recorded, RecordingWriter, read_recording
from rover_ncp.wire import messages

POLICY, COURSE = load_policy("parking"), load_course("tests/data/short_course.yaml")
HOUR_NS = 3600 * 10**9
BOOT_NS = 5_000_000_000_000
"""Monotonic clock at the first tick."""
SET_AT = 21


@functools.cache
def driven():
    """A drive's messages with the records of its ticks, and the rollout."""
    told, run = drive_messages(POLICY, COURSE, truth=False)
    ticks = []
    for k in range(len(run.commands)):
        ns = BEGAN_NS + k * TICK_NS
        record = {"index": k, "predicted": False, "now_ns": BOOT_NS + k * TICK_NS, "wall_ns": ns}
        ticks.append(Recorded(TICKS_TOPIC, "std_msgs/msg/String", messages.text(json.dumps(record)), ns, ns))
    return sorted([*ticks, *told], key=lambda message: message.log_ns), run


def clock_set(told, by_ns, at, log=True):
    """Return the messages with stamps that change by ``by_ns`` from a tick on."""
    found, since_ns = [], BEGAN_NS + round(at * TICK_NS)
    for message in told:
        data = message.data
        if message.topic == TICKS_TOPIC and message.publish_ns >= since_ns:
            record = json.loads(messages.read_text(data))
            record["wall_ns"] += by_ns
            data = messages.text(json.dumps(record))
        log_ns, publish_ns = (
            moment + by_ns * (moment >= since_ns) for moment in (message.log_ns, message.publish_ns)
        )
        log_ns = log_ns if log else message.log_ns
        found.append(replace(message, data=data, log_ns=log_ns, publish_ns=publish_ns))
    return found


def write(path, *setting):
    """Record the drive with a clock that is set as `clock_set` does."""
    with RecordingWriter(path) as writer:
        writer.attach(POLICY_FILE, policy_to_yaml(POLICY).encode())
        writer.attach(COURSE_FILE, dump_yaml(COURSE.model_dump(mode="json")).encode())
        for message in clock_set(driven()[0], *setting or (0, 0)):
            writer.write(message)
    return path


@pytest.fixture(scope="module")
def unset(tmp_path_factory):
    """The recording of the drive while no clock was set."""
    return write(tmp_path_factory.mktemp("unset") / "run.mcap")


@pytest.fixture(scope="module")
def unset_drive(unset):
    return read_drive(unset)


@pytest.mark.parametrize(("by_ns", "at", "log"), [(-HOUR_NS, SET_AT + 0.5, True), (2 * 10**9, 0.5, False)])
def test_clock_that_is_set_in_a_drive_changes_no_time_of_its_report(tmp_path, unset_drive, by_ns, at, log):
    drive, unset = read_drive(write(tmp_path / "set.mcap", by_ns, at, log)), unset_drive
    assert drive.timeline.traces()[0].times == pytest.approx(driven()[1].times[:-1])
    assert drive.timeline.judge() == unset.timeline.judge()
    assert dict(facts(drive.timeline, None)) == dict(facts(unset.timeline, None))
    rows = dict.fromkeys(drive.timeline.streams, 0)
    for name, stream in columns(drive.timeline, rows).items():
        expected = columns(unset.timeline, rows)[name].get("t", [])
        assert stream.get("t", []) == pytest.approx(expected, abs=0.1), name
    events, expected = drive.timeline.events, unset.timeline.events
    assert [event[1:] for event in events] == [event[1:] for event in expected]
    times = [[(e.wall_ns - BEGAN_NS) * 1e-9 for e in found] for found in (events, expected)]
    assert times[0] == pytest.approx(times[1], abs=0.2)


def test_clock_that_is_set_changes_neither_arrays_nor_the_duration_of_recovery(tmp_path, unset):
    path = write(tmp_path / "set.mcap", -HOUR_NS, SET_AT)
    for topic, rows in read_arrays(unset).items():
        assert read_arrays(path)[topic]["t"] == pytest.approx(rows["t"], abs=0.02), topic
    before = read_recording(path).messages
    content = path.read_bytes()
    path.write_bytes(content[: content.rindex(b"nav_msgs/msg/Odometry") - 200])
    found = recording.recover(path, path)
    assert found.seconds == pytest.approx(recording.recover(unset, tmp_path / "whole.mcap").seconds, abs=0.2)
    assert read_recording(path).messages == before[: found.messages]
