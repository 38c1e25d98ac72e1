"""The wall clock of a driver is set during its drive: each tool shows the same drive as without that."""

import json
from dataclasses import replace

import pytest
from kit.paths import DATA

from deploy.drive.records import TICKS_TOPIC
from deploy.view.page_data import columns
from deploy.view.recorded_drive import facts, read_drive
from rover_ncp.recording.arrays import read_arrays
from rover_ncp.recording.recording import read_recording, recover, rewrite
from rover_ncp.wire import messages

UNSET = DATA / "formats/0.1.0/drive.mcap"


@pytest.fixture
def clock_set(tmp_path):
    """The recording of a drive in whose middle the clock was set back by an hour."""
    source, by_ns, found = read_recording(UNSET), -3600 * 10**9, []
    ticks = source.topic(TICKS_TOPIC)
    since_ns = ticks[len(ticks) // 2].publish_ns
    for message in source.messages:
        data = message.data
        if message.topic == TICKS_TOPIC and message.publish_ns >= since_ns:
            record = json.loads(messages.read_text(data))
            data = messages.text(json.dumps(record | {"wall_ns": record["wall_ns"] + by_ns}))
        log_ns, publish_ns = (ns + by_ns * (ns >= since_ns) for ns in (message.log_ns, message.publish_ns))
        found.append(replace(message, data=data, log_ns=log_ns, publish_ns=publish_ns))
    rewrite(replace(source, messages=tuple(found)), tmp_path / "set.mcap")
    return tmp_path / "set.mcap"


def test_clock_that_is_set_in_a_drive_changes_no_time_of_its_report(clock_set):
    found, expected = read_drive(clock_set).timeline, read_drive(UNSET).timeline
    assert found.traces()[0].times == pytest.approx(expected.traces()[0].times)
    assert found.judge() == expected.judge()
    assert dict(facts(found, None)) == dict(facts(expected, None))
    rows = dict.fromkeys(found.streams, 0)
    for name, stream in columns(found, rows).items():
        assert stream.get("t", []) == pytest.approx(columns(expected, rows)[name].get("t", []), abs=0.1), name
    assert [event[1:] for event in found.events] == [event[1:] for event in expected.events]


def test_clock_that_is_set_changes_neither_arrays_nor_the_duration_of_recovery(clock_set, tmp_path):
    for topic, rows in read_arrays(UNSET).items():
        assert read_arrays(clock_set)[topic]["t"] == pytest.approx(rows["t"], abs=0.02), topic
    seconds = [recover(path, tmp_path / "whole.mcap").seconds for path in (clock_set, UNSET)]
    assert seconds[0] == pytest.approx(seconds[1], abs=0.2)
